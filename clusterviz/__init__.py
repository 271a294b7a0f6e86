"""clusterviz: distributed volume rendering, the same picture on any number of ranks.

    import clusterviz
    image = clusterviz.render("head.nii.gz", size=(800, 600))      # float32 (600, 800, 4), on rank 0
    if image is not None:
        image.save("head.png")

Importing the package takes milliseconds; the modules behind a name are imported when it is first used.
"""

from __future__ import annotations

import os
from importlib import import_module
from time import perf_counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Unpack

    from numpy.typing import NDArray

    from clusterviz.data.source import Grid, Source
    from clusterviz.image import compare, read_image, write_image
    from clusterviz.image.picture import Image
    from clusterviz.scene import Camera, Scene, Volume, load_scene
    from clusterviz.scene.overrides import Settings

    __version__: str

__all__ = [
    "Camera",
    "Grid",
    "Image",
    "Scene",
    "Volume",
    "__version__",
    "compare",
    "load_scene",
    "read_image",
    "render",
    "write_image",
]

REACHED = perf_counter()
"""Time of the import of this package, at the end of the interpreter's start-up."""

_MODULES = {
    "Camera": "clusterviz.scene",
    "Grid": "clusterviz.data.source",
    "Image": "clusterviz.image.picture",
    "Scene": "clusterviz.scene",
    "Volume": "clusterviz.scene",
    "compare": "clusterviz.image",
    "load_scene": "clusterviz.scene",
    "read_image": "clusterviz.image",
    "write_image": "clusterviz.image",
}

# The package `clusterviz.render` is imported before the function of the same name is defined, so that a later import
# does not replace the function.
import_module("clusterviz.render")


def render(
    scene: Scene | Source | NDArray[Any] | str | os.PathLike[str] | Sequence[Source | NDArray[Any]],
    *,
    grid: Grid | Sequence[Grid] | None = None,
    comm: Any = None,
    **settings: Unpack[Settings],
) -> Image | None:
    """Render a picture on all ranks of an MPI job, or in this process.

    Parameters
    ----------
    scene : Scene, path, array, data source, mesh, unstructured grid, or list of arrays and sources
        A scene, the path of a scene file or data file, or an array (z, y, x) of any integer or float type. An
        object with `name`, `grid`, `dtype` and `read` is a data source (see `clusterviz.data.source`); each rank reads
        its own boxes. A list of arrays and data sources gives one volume each. All ranks pass the same scene.
    grid : Grid or list of Grid, optional
        Spacing, origin and direction of an array, or a list for several; the default spacing is 1.
    comm : mpi4py.MPI.Comm, optional
        Communicator of the ranks; by default all processes of the job.
    **settings
        Scene keys by their last names: size=(800, 600), cmap="viridis", clim=(0, 1), step=0.5, position=(5, 0, 0),
        background="black", brick=32; `clusterviz schema` lists them. Keys of a volume apply to the first one; other
        volumes need the full path, as in ``**{"volumes.1.cmap": "hot"}``. A section is a dict or a value:
        camera={"position": (5, 0, 0)}, camera=Camera(position=(5, 0, 0)). Items of meshes, lines, points and grids may
        be objects in memory, alone or in place of a path: meshes=[{"path": mesh, "opacity": 0.4}], where a mesh is
        (vertices, faces), or an object of trimesh or pyvista; lines are arrays (k, 3), points an array (n, 3). Items
        of grids are unstructured grids of pyvista or meshio, or (points, tetrahedra, scalars).

    Returns
    -------
    image : Image or None
        On rank 0 an array, float32 (h, w, 4), premultiplied, without the background; None on other ranks. `show()` and
        `save("picture.png")` blend it over the scene's background. With layers=["depth", "normal"] its `layers` holds
        an array for each, and `save("picture.exr")` writes them too.

    Raises
    ------
    clusterviz.errors.ClustervizError
        On every rank: SceneError, DataError, DeviceError, or RankError if a single rank failed. A failure of a single
        rank during communication ends the job instead.
    """
    from clusterviz.comm import agree, limit_threads, open_channel
    from clusterviz.comm.mpi import MpiChannel
    from clusterviz.errors import InputError
    from clusterviz.frame import render_frame
    from clusterviz.image.picture import Image, layers_of
    from clusterviz.scene import background_rgb
    from clusterviz.scene.overrides import with_settings

    channel = open_channel() if comm is None else MpiChannel(comm)
    try:
        if channel.size > 1:
            limit_threads(channel.placement())
        with agree(channel, 0, "scene"):
            opened, source = _scene_and_source(scene, grid)
            named, in_memory = _named_objects(dict(settings))
            opened = with_settings(opened, named)
            if in_memory:
                source = _joined_sources(opened, source, in_memory)
            elif source is not None and any(v.time is not None or v.channel is not None for v in opened.volumes):
                allowed = "array[time], array[..., channel]"
                raise InputError("only files have time steps and channels", where="render", allowed=allowed)
        rendered = render_frame(opened, channel, source)
        if rendered.image is None:
            return None
        found = rendered.image
        return Image(found, background_rgb(rendered.scene.image.background), layers_of(found))
    finally:
        if isinstance(channel, MpiChannel) and comm is not None:
            channel.close()


def _named_objects(settings: dict[str, Any]) -> tuple[Any, dict[str, list[Any]]]:
    """Return settings with a name in place of each object in meshes, lines, points and grids, and the objects."""
    from clusterviz.data.geometry import as_geometry
    from clusterviz.data.vtk_cells import as_grid
    from clusterviz.scene.field_types import Section
    from clusterviz.scene.grids import LISTED_SECTIONS

    found: dict[str, list[Any]] = {}
    for name in LISTED_SECTIONS.keys() & settings.keys():
        items, sections = settings[name], []
        is_one = not isinstance(items, (list, tuple)) or (name in ("meshes", "grids") and isinstance(items, tuple))
        found[name] = []
        for number, item in enumerate([items] if is_one else items):
            section: Any = item if isinstance(item, (dict, Section)) else {"path": item}
            given = section.get("path") if isinstance(section, dict) else None
            if given is None or isinstance(given, (str, os.PathLike)):
                found[name].append(None)
            else:
                key = f"{name}[{number}]"
                found[name].append(as_grid(given, key) if name == "grids" else as_geometry(given, name, key))
                section = {**section, "path": "array"}
            sections.append(section)
        settings[name] = sections
    return settings, found


def _joined_sources(scene: Scene, source: Any, in_memory: dict[str, list[Any]]) -> list[Any]:
    """Return what is given for each volume, entry of geometry and grid of a scene; None: the file is read."""
    from clusterviz.scene.grids import LISTED_SECTIONS

    given = list(source) if isinstance(source, list) else [source] * len(scene.volumes)
    joined, rest = given[: len(scene.volumes)], given[len(scene.volumes) :]
    for name in LISTED_SECTIONS:
        count = len(getattr(scene, name))
        if name in in_memory:
            joined += in_memory[name]
        else:  # as the scene was given: in memory, or files
            joined += rest[:1] * count if rest else [None] * count
    return joined


def _scene_and_source(given: Any, grid: Any) -> tuple[Scene, Any]:
    """Return the scene of an argument of `render`, and the data if it is not a file."""
    from clusterviz.data import open_scene
    from clusterviz.data.geometry import Geometry, Lines, Points, as_geometry
    from clusterviz.data.memory import ArraySource
    from clusterviz.data.vtk_cells import as_grid, is_grid
    from clusterviz.errors import InputError
    from clusterviz.scene import Scene, Volume
    from clusterviz.scene.geometry import GEOMETRY_SECTIONS, as_sections
    from clusterviz.scene.grids import GridSection

    if isinstance(given, (list, tuple)):
        return _several(given, grid)
    if is_grid(given):
        return Scene(grids=(GridSection(path="array"),), automatic=True), [as_grid(given, "render")]
    if any(hasattr(given, name) for name in ("faces", "vertices")) or isinstance(given, (Geometry, Lines, Points)):
        # Objects of pyvista may have all, of which some are empty.
        cells = (("meshes", "faces"), ("lines", "lines"))
        kind = next((name for name, attribute in cells if len(getattr(given, attribute, ()))), "points")
        geometry = as_geometry(given, kind, "render")
        parts = {"meshes": geometry.mesh, "lines": geometry.lines, "points": geometry.points}
        each = [section(path="array") for name, section in GEOMETRY_SECTIONS.items() if parts[name]]
        sections: dict[str, Any] = as_sections(each)
        return Scene(**sections, automatic=True), [geometry] * len(each)
    if hasattr(given, "__array__"):
        import numpy as np

        given, grid = ArraySource(np.asarray(given), grid), None
    if grid is not None:
        raise InputError("only an array takes a grid", where="render", found=f"a grid and {type(given).__name__}")
    if isinstance(given, Scene):
        return given, None
    if isinstance(given, (str, os.PathLike)):
        return open_scene(given), None
    if all(hasattr(given, name) for name in ("name", "grid", "dtype", "read")):
        return Scene(volumes=(Volume(path=given.name),), automatic=True), given
    raise InputError("nothing to render", where="render", found=type(given).__name__, allowed="a scene, path or array")


def _several(given: Sequence[Any], grids: Any) -> tuple[Scene, list[Source]]:
    """Return the scene of several arrays and data sources, and the sources."""
    from clusterviz.errors import InputError
    from clusterviz.scene import Scene

    each = [None] * len(given) if grids is None else list(grids)
    if len(each) != len(given):
        raise InputError("not one for each volume", where="render: grid", found=len(each), allowed=len(given))
    parts = [_scene_and_source(data, grid) for data, grid in zip(given, each, strict=True)]
    sources: list[Any] = [source for _, source in parts]
    if not parts or any(source is None or isinstance(source, list) for source in sources):
        allowed = "arrays, or objects with name, grid, dtype and read; files go into a scene"
        raise InputError("not data", where="render", found="a list of other things", allowed=allowed)
    return Scene(volumes=tuple(volume for scene, _ in parts for volume in scene.volumes), automatic=True), sources


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("clusterviz")
    if name not in _MODULES:
        raise AttributeError(f"module 'clusterviz' has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
