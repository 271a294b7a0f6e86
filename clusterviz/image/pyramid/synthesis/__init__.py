"""Filters that double the size, one file each."""
