"""clusterviz: distributed volume rendering, the same picture on any number of ranks.

    import clusterviz
    image = clusterviz.render("head.nii.gz", size=(800, 600))      # float32 (600, 800, 4), on rank 0
    if image is not None:
        image.save("head.png")

The map of the house, in the order in which a frame passes through it (docs/flow.md walks along):

    scene -> plan -> partition -> render -> composite -> image

    cli/          the commands, one file each
    frame.py      the loop: the only file that calls the stages
    errors.py     every failure a user can meet
    scene/        what to show: frozen values, YAML in and out
    data/         where voxels live: one file a format, bricks, summaries
    plan/         one frame's decisions as one frozen value
    partition/    who holds what, and in which order it is seen
    render/       one rank's partial image
    composite/    many partial images, one picture: one file an algorithm
    image/        pixels: regions, files, comparing
    report/       what happened: statistics
    codec/        pixels to bytes and back
    comm/         how ranks talk; the only room that knows MPI
    gl/           OpenGL without a screen
    reference/    the witness: float64 NumPy twins of the fast paths

Importing the package costs milliseconds; what a name needs is imported when it is first used.
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

    from clusterviz.data.grid import Grid
    from clusterviz.data.source import Source
    from clusterviz.image import compare, read_image, write_image
    from clusterviz.image.picture import Image
    from clusterviz.scene import Camera, Scene, Volume, load_scene
    from clusterviz.scene.settings import Settings

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
"""When Python came here: what lies before it is the interpreter's own start."""

_HOMES = {
    "Camera": "clusterviz.scene",
    "Grid": "clusterviz.data.grid",
    "Image": "clusterviz.image.picture",
    "Scene": "clusterviz.scene",
    "Volume": "clusterviz.scene",
    "compare": "clusterviz.image",
    "load_scene": "clusterviz.scene",
    "read_image": "clusterviz.image",
    "write_image": "clusterviz.image",
}

# A room has the name of the function below. Python binds a package's name when it is first imported: now, so not later.
import_module("clusterviz.render")


def render(
    scene: Scene | Source | NDArray[Any] | str | os.PathLike[str] | Sequence[Source | NDArray[Any]],
    *,
    grid: Grid | Sequence[Grid] | None = None,
    comm: Any = None,
    **settings: Unpack[Settings],
) -> Image | None:
    """Render one picture, on all ranks together, or in this process alone where there is no mpirun.

    Parameters
    ----------
    scene : a Scene, the path of a scene file or of a data file, or an array: any integer or float type, (z, y, x).
        Under mpirun every rank gives the same. Anything with `name`, `grid`, `dtype` and `read` is taken as data too
        (see `clusterviz.data.source`): each rank then reads its own boxes only. A list of arrays and data: as many
        volumes in one picture.
    grid : spacing, origin and direction of an array; by default its samples lie 1 apart; of several, a list
    comm : the mpi4py communicator of the ranks; by default all processes of the job
    **settings : any key of a scene by its last name: size=(800, 600), cmap="viridis", clim=(0, 1), step=0.5,
        position=(5, 0, 0), background="black", brick=32; `clusterviz schema` lists them. What is said of a volume is
        said of the first; of another by its whole key, as in **{"volumes.1.cmap": "hot"}. A section as a whole is a
        dict or a value: camera={"position": (5, 0, 0)}, camera=Camera(position=(5, 0, 0))

    Returns
    -------
    image : on rank 0, None on the others: an array, float32 (h, w, 4), premultiplied, before the background, with
        `show()` and `save("picture.png")`, which put it over the scene's background

    Raises
    ------
    clusterviz.errors.ClustervizError
        On every rank alike; SceneError, DataError, DeviceError, or RankError where one rank alone failed. A failure
        amid messages, which other ranks cannot know of, ends the job instead.
    """
    from clusterviz.comm import agree, limit_threads, open_channel
    from clusterviz.comm.mpi import MpiChannel
    from clusterviz.errors import InputError
    from clusterviz.frame import render_frame
    from clusterviz.image.picture import Image
    from clusterviz.scene import background_rgb
    from clusterviz.scene.settings import with_settings

    channel = open_channel() if comm is None else MpiChannel(comm)
    try:
        if channel.size > 1:
            limit_threads(channel.placement())
        with agree(channel, 0, "scene"):
            opened, source = _scene_and_source(scene, grid)
            opened = with_settings(opened, settings)
            if source is not None and any(v.time is not None or v.channel is not None for v in opened.volumes):
                allowed = "array[time], array[..., channel]"
                raise InputError("only files have time steps and channels", where="render", allowed=allowed)
        rendered = render_frame(opened, channel, source)
        if rendered.image is None:
            return None
        return Image(rendered.image, background_rgb(rendered.scene.image.background))
    finally:
        if isinstance(channel, MpiChannel) and comm is not None:
            channel.close()


def _scene_and_source(given: Any, grid: Any) -> tuple[Scene, Source | list[Source] | None]:
    """What to show, and where its voxels are where no file holds them."""
    from clusterviz.data.memory import ArraySource
    from clusterviz.errors import InputError
    from clusterviz.scene import Scene, Volume, open_scene

    if isinstance(given, (list, tuple)):
        return _several(given, grid)
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
    """The scene of several arrays and other data, with a grid or None for each."""
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
    if name not in _HOMES:
        raise AttributeError(f"module 'clusterviz' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
