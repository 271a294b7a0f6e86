"""Sections of a scene that list content, each with the class of its entries; their kinds are in `content.table`."""

from __future__ import annotations

from clusterviz.content.flow.section import FlowSection
from clusterviz.content.geometry.section import GEOMETRY_SECTIONS
from clusterviz.content.grid.section import GridSection
from clusterviz.content.volume.section import Volume
from clusterviz.scene.field_types import Section

LISTED_SECTIONS: dict[str, type[Section]] = {**GEOMETRY_SECTIONS, "grids": GridSection, "flows": FlowSection}
"""Those other than volumes, in the order in which equal depths are composited."""
CONTENT_SECTIONS: dict[str, type[Section]] = {"volumes": Volume, **LISTED_SECTIONS}
