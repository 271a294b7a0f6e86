"""Compositing algorithms as schedules of transfers: pure data, one file an algorithm.

- schedule.py    schedules as data, counted and checked
- algorithms.py  registry
- rectangles.py  arrays of patches
"""
