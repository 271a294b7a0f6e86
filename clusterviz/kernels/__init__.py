"""The kernels room: machine code that is made here, kept as files, and loaded without a compiler.

- objects.py  object files: made once for a processor, found again by what they were made from
- lanes.py    values of code, numbers and vectors, and expressions of them
- code.py     functions that are written
"""
