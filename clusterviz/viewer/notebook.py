"""`clusterviz.view`: live view of data in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from clusterviz.data.given import given_scene
from clusterviz.errors import ClustervizError, InputError, installation
from clusterviz.image.picture import is_notebook

if TYPE_CHECKING:
    from typing import Unpack

    from clusterviz.data.source import Grid
    from clusterviz.scene.settings import Settings
    from clusterviz.viewer.widget import Viewer


def view(
    scene: Any = None,
    *,
    grid: Grid | Sequence[Grid] | None = None,
    ranks: int | None = None,
    **settings: Unpack[Settings],
) -> Viewer:
    """Show a live view in a notebook.

    Parameters
    ----------
    scene, grid, **settings
        As in `clusterviz.render`.
    ranks : int, optional
        Draw by so many processes, which are started by mpirun on this machine and end with the widget or the kernel.
        Arrays are copied into temporary files for them; meshes and grids have to be files. By default a thread of the
        kernel draws.

    Returns
    -------
    widget : Viewer
        Widget with `scene`, `camera`, `edit`, `snapshot` and `close`; a cell that ends with it shows the view.

    Raises
    ------
    clusterviz.errors.ClustervizError
        As `clusterviz.render` does; outside of a notebook; and without the packages of the extra `notebook`.
    """
    if not is_notebook():
        allowed = "a notebook; elsewhere the command `clusterviz view`, which shows the same in a browser"
        raise InputError("there is no notebook here", where="view", allowed=allowed)
    if ranks is not None and ranks < 1:
        raise InputError("not a number of ranks", where="view: ranks", found=ranks, allowed="1 or more, or None")
    try:
        from clusterviz.viewer.local_session import LocalSession
        from clusterviz.viewer.remote_session import RemoteSession
        from clusterviz.viewer.widget import Viewer
    except ModuleNotFoundError as error:
        raise ClustervizError(f"notebooks need {error.name}: {installation('notebook')}") from None
    opened, sources = given_scene(scene, grid, settings, "view")
    return Viewer(LocalSession(opened, sources) if ranks is None else RemoteSession(opened, sources, ranks))
