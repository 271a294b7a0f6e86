"""Table of the pyramid's filters; each file is the manual of its filter.

| | basic | analysis | synthesis |
|---|---|---|---|
| discontinuous | box | box 2 x 2 | nearest |
| C⁰ | bartlett | box 4 x 4, bartlett 3 x 3 | midpoint |
| C¹ | gauss 5 x 5 | quadratic 4 x 4 | doo-sabin |
| C² | | cubic 5 x 5 | cubic |
"""

from __future__ import annotations

from clusterviz.errors import InputError
from clusterviz.image.pyramid.analysis.bartlett import BARTLETT_3
from clusterviz.image.pyramid.analysis.box_2 import BOX_2
from clusterviz.image.pyramid.analysis.box_4 import BOX_4
from clusterviz.image.pyramid.analysis.cubic import CUBIC_5
from clusterviz.image.pyramid.analysis.quadratic import QUADRATIC_4
from clusterviz.image.pyramid.basic.bartlett import BARTLETT
from clusterviz.image.pyramid.basic.box import BOX
from clusterviz.image.pyramid.basic.gauss import GAUSS_5
from clusterviz.image.pyramid.contract import Filter
from clusterviz.image.pyramid.synthesis.cubic import CUBIC
from clusterviz.image.pyramid.synthesis.doo_sabin import DOO_SABIN
from clusterviz.image.pyramid.synthesis.midpoint import MIDPOINT
from clusterviz.image.pyramid.synthesis.nearest import NEAREST

BASIC = {each.name: each for each in (BOX, BARTLETT, GAUSS_5)}
ANALYSIS = {each.name: each for each in (BOX_2, BOX_4, BARTLETT_3, QUADRATIC_4, CUBIC_5)}
SYNTHESIS = {each.name: each for each in (NEAREST, MIDPOINT, DOO_SABIN, CUBIC)}


def find(table: dict[str, Filter], name: str, where: str) -> Filter:
    """Return a filter by its name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in table:
        raise InputError("no such filter", where=where, found=name, allowed=", ".join(table))
    return table[name]
