"""Compositing algorithms as schedules of transfers: pure data, one file an algorithm."""
