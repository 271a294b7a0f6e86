"""The over operator as compiled vector code: for two images, and for many layers in one pass.

The operators of projections (maximum, minimum, sum, run) and of spectral volumes (two-flux) use the same kernels.
"""
