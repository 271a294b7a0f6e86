"""Who sends what to whom: one file an algorithm, each a pure schedule.

- schedule.py    a schedule as data, counted and checked
- algorithms.py  the registry
- cuts.py        where to cut the picture, from the footprints
- rectangles.py  patches of many ranks as columns
- load.py        what a schedule asks of each rank
"""
