"""Filters that keep the size, one file each."""
