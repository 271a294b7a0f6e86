"""Analysis of the k-buffer: how many entries each pixel needs, and what smaller buffers get wrong."""
