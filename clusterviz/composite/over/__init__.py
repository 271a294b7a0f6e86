"""The over operator as compiled vector code: for two images, and for many layers in one pass.

The operators of projections (maximum, minimum, sum, run) and of spectral volumes (two-flux) use the same kernels.

- blend.py, layers.py   two images, many layers; each with a plain NumPy reference
- job.py      jobs of the kernels: arrays as addresses in a table of numbers; their object files
- kernels.py  the kernels
- intrinsics.py, vector_code.py, geometry.py   parts of the kernels
- merging_pixels.py   the other operators
"""
