"""The report room: what happened, as values.

- statistics.py  seconds, bytes and counts of a frame
- machine.py     what each rank has to work with
"""
