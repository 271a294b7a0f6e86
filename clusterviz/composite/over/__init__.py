"""The over operator, compiled to vectors: two images at a time, many layers in one pass, the nearest of depths.

The operators of projections (maximum, minimum, sum, stretch) run in the same kernels.

- blend.py   two images; the plain NumPy twin
- layers.py  many layers in one pass, rounded once
- depth.py   the nearest fragment
- job.py, job_layout.py                                  what compiled code shall do, as a table of numbers
- pair_kernels.py, layer_kernels.py, depth_kernels.py    the kernels
- instructions.py, vector_code.py, places.py, sums.py    what kernels are made of
- merge_code.py, merging_pixels.py                       the operators of projections
- native.py                                              compiled once for all, loaded without a compiler
"""
