"""clusterviz: distributed volume rendering, the same picture on any number of ranks.

    import clusterviz
    image = clusterviz.render("head.nii.gz", size=(800, 600))      # float32 (600, 800, 4), on rank 0
    if image is not None:
        image.save("head.png")

Importing the package takes milliseconds; the modules behind a name are imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from time import perf_counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Unpack

    from clusterviz.data.source import Grid
    from clusterviz.image import compare, read_image, write_image
    from clusterviz.image.picture import Image
    from clusterviz.scene import Camera, Scene, Volume, load_scene
    from clusterviz.scene.settings import Settings
    from clusterviz.viewer.notebook import view

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
    "view",
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
    "view": "clusterviz.viewer.notebook",
    "write_image": "clusterviz.image",
}

# The package `clusterviz.render` is imported before the function of the same name is defined, so that a later import
# does not replace the function.
import_module("clusterviz.render")


def render(
    scene: Any = None,
    *,
    grid: Grid | Sequence[Grid] | None = None,
    comm: Any = None,
    **settings: Unpack[Settings],
) -> Image | None:
    """Render a picture on all ranks of an MPI job, or in this process.

    Parameters
    ----------
    scene : Scene, path, array, object of another library, data source, or list of volumes, optional
        A scene, the path of a scene file or data file, or an array (z, y, x) of any integer or float type. Objects of
        pyvista, trimesh, meshio, nibabel, SimpleITK, ITK and xarray are taken with their places and arrays; a mesh may
        be (vertices, faces), an unstructured grid (points, tetrahedra, scalars). An object with `name`, `grid`, `dtype`
        and `read` is a data source (see `clusterviz.data.source`); each rank reads its own boxes. A list of volumes
        gives one volume each. All ranks pass the same scene. It may be left out where volumes, meshes, lines, points,
        grids or flows are given by their keys.
    grid : Grid or list of Grid, optional
        Spacing, origin and direction of an array, or a list for several; the default spacing is 1.
    comm : mpi4py.MPI.Comm, optional
        Communicator of the ranks; by default all processes of the job.
    **settings
        Scene keys by their last names: size=(800, 600), cmap="viridis", clim=(0, 1), step=0.5, position=(5, 0, 0),
        background="black", brick=32; `clusterviz schema` lists them. Keys of a volume apply to the first one; other
        volumes need the full path, as in ``**{"volumes.1.cmap": "hot"}``. A section is a dict or a value:
        camera={"position": (5, 0, 0)}, camera=Camera(position=(5, 0, 0)). Items of meshes, lines, points, grids and
        flows may be objects in memory, alone or in place of a path: meshes=[{"path": mesh, "opacity": 0.4}]. A mesh is
        (vertices, faces), or an object of trimesh or pyvista; lines are arrays (k, 3), points an array (n, 3). Items
        of grids are unstructured grids of pyvista or meshio, or (points, tetrahedra, scalars); items of flows are
        arrays of vectors (z, y, x, 3), or `clusterviz.data.vectors.VectorArray` with a grid and time steps.

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
    from clusterviz.data.given import given_scene
    from clusterviz.frame import Options, render_frame
    from clusterviz.image.picture import Image, layers_of
    from clusterviz.scene import background_rgb

    channel = open_channel() if comm is None else MpiChannel(comm)
    try:
        if channel.size > 1:
            limit_threads(channel.placement())
        with agree(channel, 0, "scene"):
            opened, sources = given_scene(scene, grid, settings, "render", warns=channel.rank == 0)
        rendered = render_frame(opened, channel, sources, Options(annotate=True))
        if rendered.image is None:
            return None
        found = rendered.image
        return Image(found, background_rgb(rendered.scene.image.background), layers_of(found))
    finally:
        if isinstance(channel, MpiChannel) and comm is not None:
            channel.close()


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
