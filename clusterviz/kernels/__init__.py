"""Machine code of kernels: generated with LLVM, saved as object files, and loaded without a compiler.

- objects.py   object files, made once for a CPU and its sources
- compiled.py  kernels written in Python, made by numba
"""
