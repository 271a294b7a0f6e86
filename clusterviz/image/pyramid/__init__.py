"""Pyramid filters of pictures and grids, made of bilinear fetches, and what is built of them.

contract.py   a filter as data: passes of one fetch a pixel
basic/        filters that keep the size: box, Bartlett, Gauss
analysis/     filters that halve it
synthesis/    filters that double it
filters.py    the table of all
executor.py   any filter on CPU vectors or OpenGL
blur.py       images blurred by any width
interpolation.py  holes and scattered values: pull-push
zoom.py       edge-directed magnification
"""

from __future__ import annotations

from clusterviz.image.pyramid.blur import blur
from clusterviz.image.pyramid.executor import apply_filter
from clusterviz.image.pyramid.interpolation import interpolate
from clusterviz.image.pyramid.zoom import zoom

__all__ = ["apply_filter", "blur", "interpolate", "zoom"]
