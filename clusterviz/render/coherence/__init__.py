"""What a frame tells the next one: where rays start by what those of the last frame hit.

- last_frame.py           what is remembered, and when it holds
- reprojection.py         hits of one view as starts of another one
- reprojection_kernel.py  the same, compiled
"""
