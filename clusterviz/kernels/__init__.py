"""Machine code of kernels: generated with LLVM, saved as object files, and loaded without a compiler."""
