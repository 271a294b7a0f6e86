"""Depth complexity of a scene: fragments of meshes, lines and points at each pixel, and the memory that they need."""
