"""Frame coherence: rays of a frame start shortly before the hits of the last frame.

The last frame's hits are kept by `last_frame.py`, and reprojected by `reprojection.py` with a compiled kernel.
"""
