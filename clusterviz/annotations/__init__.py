"""Annotations: scalar bars, outline, axes grid, orientation marker, text, scale bar and legend of a picture."""

from __future__ import annotations

from clusterviz.annotations.canvas import check_library
from clusterviz.annotations.defaults import with_annotations
from clusterviz.annotations.picture import annotated

__all__ = ["annotated", "check_library", "with_annotations"]
