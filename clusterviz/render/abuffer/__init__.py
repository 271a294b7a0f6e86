"""Meshes, lines and points in a box of bricks, drawn with its volumes by an A-buffer.

For each frame, `tiles.py` moves vertices to the camera's coordinates and lists the primitives of each tile of pixels. A
program (`program.py`, shaders/abuffer/) intersects each pixel's ray with those of its tile, counts the fragments, and
stores them without gaps. The program of the volumes then composites them where their slabs are.
"""
