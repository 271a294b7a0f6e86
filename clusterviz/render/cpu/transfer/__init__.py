"""Transfer functions.

- classify.py  what they give samples
- pieces.py    the same where pieces are few, in registers
- ramps.py     what they give slabs along which the scalar goes linearly
- grading.py   opacity by the gradient's magnitude
- opacity.py   opacities of slabs
- tables.py    rows of tables, a lane each
"""
