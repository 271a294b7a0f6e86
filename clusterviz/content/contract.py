"""Contract of a kind of content: what the stages of a frame need of it, so that none asks which kind an entry is.

A scene lists entries in sections (`volumes`, `meshes`, …), which belong to kinds. `content.table` lists the kinds, one
line each, in the order of drawing at equal depths; stages loop over the entries of a scene, and call what their kind
has for them:

    open -> complete -> draw -> describe

- `open` reads what has to be known, on all ranks together, each its share, and returns an opened entry for each of the
  kind's: at least `info`, facts that are the same on every rank.
- `becomes` is for kinds that are drawn as entries of other kinds, as flows are: they are opened first, and what they
  become is opened, completed and drawn like the scene's own entries. Such entries are marked by `of_flow`, belong to no
  file, and are neither described nor written.
- An opened entry of a kind that `must_fit` has `layer(section, lights, bricks)`, the `plan.geometry.Layer` of a plan,
  and `read(layer, bricks, wanted)`, what it has in some bricks, by index; both are collective.
- `complete` fills the keys that drawing needs from facts. It is pure and idempotent: ranks with equal facts get equal
  entries, and completed entries stay as they are.
- `corners` and `visible` are the boxes that the camera fits and annotations show.
- What stages ask of an entry beside this is said by its section, a `ContentSection`: what rays collect of it, for
  example.
- The others describe entries to people: `summary` to readers of the terminal, `legend` to those of the picture, `panel`
  to the viewer, `warnings` to those who see less than they expect.

Functions of entries take the entry's section, and most the facts on it. All are pure but `open` and `becomes`, whose
failures are agreed on by all ranks (`comm.agree`), as `InputError` or `DataError`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.facts import Facts, bounds, box_corners
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.transfer_2d import TransferTable

if TYPE_CHECKING:
    from clusterviz.frame.run import Image, Run
    from clusterviz.render.crossing import FoundLayers
    from clusterviz.scene.values import Scene

Corners = NDArray[np.float64]
"""Points that span a box, float64 (n, 3), world; none of an entry that shows nothing."""


@dataclass(frozen=True, eq=False)
class LegendEntry:
    """Entry as scalar bars and the legend show it.

    Attributes
    ----------
    name : of the array, or of the file
    colours : float64 (n, 3), straight, for the legend; (0, 3) if they are not known
    transfer : transfer function; None without scalars, and if a shader gives the colours
    surfaces : scalars and opacities of isosurfaces
    has_opacity : whether opacity is a function of the scalars beside the surfaces
    table : two-dimensional transfer function
    shared : entries in which it is equal, and not None, are listed once
    """

    name: str
    colours: NDArray[np.float64]
    transfer: TransferFunction | None = None
    surfaces: tuple[tuple[float, float], ...] = ()
    has_opacity: bool = False
    table: TransferTable | None = None
    shared: object = None


class Painter(Protocol):
    """What adds to a composited picture by what ranks have found for other layers."""

    def paint(self, run: Run, scene: Scene, layers: Sequence[FoundLayers], /) -> Image | None:
        """Return what is added to a frame's picture, float32 (h, w, 4), on rank 0; collective."""


@dataclass(frozen=True)
class Kind:
    """Kind of content.

    Attributes
    ----------
    name : of the attribute of a scene that has all entries of the kind
    sections : keys of a scene that list its entries
    facts : class of the information on an entry
    opened : keys that all frames of a loop share; empty: all but `changing`
    changing : keys that may differ between frames, since neither bricks nor what was read depend on them
    open : (run, scene, sections with keys, what is given in place of each file) -> opened entries; collective
    complete : (section, info) -> section with all keys
    corners : (section, info) -> corners of the box around the whole entry
    visible : (section, info) -> corners around what is visible of it
    summary : (key, section) -> how it looks, in one line
    legend : section -> how it is listed beside the picture
    panel : (section, info) -> what clients of the viewer are told of it beside name and transfer function
    warnings : (key, section, info, corners of each other entry) -> warnings about what is not visible, by subject
    blank : (section, info) -> what to check where the whole picture is empty
    check : scene -> None; refuses what can be said of the kind's entries, but no renderer draws
    becomes : (scene, infos) -> scene with the entries of other kinds that this one is drawn as
    painter : (run, scene, opened entries) -> what adds to composited pictures, or None; collective
    free : opened entry -> None; releases what ranks share; collective
    must_fit : it has primitives or cells in bricks of the domain, all of which have to fit into memory at once
    read : section -> its data, as may be given in place of its file; samples are read later
    referenced : (section, data) -> what the float64 reference draws
    unchecked : section -> what the reference does not draw of it, as "shows no …", or ""
    faint : settings beside `opacity` that make an entry nearly transparent, such as optics=null
    preset : (section, info) -> name of the preset that automatic settings choose, or ""
    """

    name: str
    sections: tuple[str, ...]
    facts: type[Facts]
    open: Callable[[Run, Scene, Sequence[tuple[str, Any]], Sequence[Any]], Sequence[Any]]
    complete: Callable[[Any, Any], Any]
    summary: Callable[[str, Any], str]
    legend: Callable[[Any], LegendEntry]
    warnings: Callable[[str, Any, Any, Sequence[Corners]], Mapping[str, str]]
    corners: Callable[[Any, Any], Corners] = lambda section, info: box_corners(info.grown_box(section))
    visible: Callable[[Any, Any], Corners] = lambda section, info: box_corners(info.grown_box(section))
    panel: Callable[[Any, Any], Mapping[str, Any]] = lambda _, info: {"bounds": bounds(info.box)}
    blank: Callable[[Any, Any], str] = lambda *_: "check opacity, culling and clip"
    opened: tuple[str, ...] = ()
    changing: tuple[str, ...] = ()
    check: Callable[[Scene], None] = lambda _: None
    becomes: Callable[[Scene, Sequence[Any]], Scene] | None = None
    painter: Callable[[Run, Scene, Sequence[Any]], Painter | None] = lambda *_: None
    free: Callable[[Any], None] = lambda _: None
    must_fit: bool = False
    read: Callable[[Any], Any] = lambda _: None
    referenced: Callable[[Any, Any], Any] = lambda _, data: data
    unchecked: Callable[[Any], str] = lambda _: ""
    faint: tuple[str, ...] = ()
    preset: Callable[[Any, Any], str] = lambda *_: ""


@dataclass(frozen=True, eq=False)
class Entry:
    """Entry of a scene: its kind, its key such as `meshes[0]`, its section, and the facts on it, if it is opened."""

    kind: Kind
    key: str
    section: Any
    info: Any = None
