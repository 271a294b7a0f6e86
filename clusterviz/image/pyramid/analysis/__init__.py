"""Filters that halve the size, one file each."""
