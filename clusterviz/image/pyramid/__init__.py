"""Pyramid filters of pictures and grids, made of bilinear fetches, and what is built of them.

contract.py   a filter as data: passes of one fetch a pixel
filters.py    the table of all: those that keep the size, halve it, and double it
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
