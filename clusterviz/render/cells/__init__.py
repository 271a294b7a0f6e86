"""Unstructured grids in a box of bricks, through whose tetrahedra rays walk.

The tetrahedra of all bricks of a box are joined to one local grid, whose neighbours are found again (`table.py`), so
that walks cross bricks. The boundary faces are primitives of the A-buffer, of which a ray's list holds those by which
it enters. The program of the volumes then integrates between entry and exit, in the slabs that the box owns
(shaders/cells/).
"""
