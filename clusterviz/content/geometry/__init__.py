"""Geometry: meshes, lines and points."""
