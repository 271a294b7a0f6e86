"""The field that voxels stand for.

- field.py       the scalar at a place
- cubic.py       cubic B-splines
- gradient.py    gradients
- directions.py  directions and lengths that cannot overflow
"""
