"""Unstructured grids: tetrahedra, hexahedra, wedges and pyramids."""
