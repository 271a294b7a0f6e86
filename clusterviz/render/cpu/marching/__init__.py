"""Rays, their slabs, and the march from run to run.

- tile.py     a tile of the picture
- state.py    what is known of its packets
- rays.py     rays and their slabs
- jitter.py   where lattices begin that are other in every pixel
- clip.py     which slabs clipping planes keep
- place.py    where slabs are
- empty_space.py    how far rays may skip over what is empty
- stretch.py  slabs that are longer where groups of cells allow it
- starts.py   where rays start by what the last frame found
- march.py    from run to run
- split.py    the same where slabs are cut as they leave a brick
- faces.py    where rays meet the faces of bricks
- bodies.py   where rays and runs are in each of several volumes
"""
