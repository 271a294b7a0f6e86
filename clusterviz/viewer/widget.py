"""Widget of Jupyter notebooks that shows a live session; see `clusterviz.view`."""

from __future__ import annotations

import asyncio
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Unpack

import anywidget
import traitlets

from clusterviz.errors import SceneError
from clusterviz.image.picture import Image
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Scene
from clusterviz.viewer.bundle import bundled_modules, bundled_styles
from clusterviz.viewer.scene_client import Connection, NotebookSession, SceneClient

if TYPE_CHECKING:
    from clusterviz.scene.settings import Settings

SILENCE_SECONDS = 75.0
"""Time after which a view counts as gone: views send a heartbeat every 20 seconds, browsers in the background less."""


class Viewer(anywidget.AnyWidget):
    """Widget that shows a session of a scene; each time that it is displayed is one more view of the session.

    Attributes
    ----------
    scene : Scene
        The scene that is shown, with all keys. Assign another one to show it; see `edit` for single keys.
    camera : dict
        position, focal_point, view_up, view_angle and parallel_scale of the newest picture, also while the view moves.
        Assign a dict with any of these keys. It can be linked: ``ipywidgets.link((a, "camera"), (b, "camera"))``.
    height : int
        Height of the views in CSS pixels.
    """

    _esm = bundled_modules("notebook")
    _css = bundled_styles()

    height = traitlets.Int(480, min=100).tag(sync=True)
    scene = traitlets.Instance(Scene)
    camera = traitlets.Dict()

    def __init__(self, session: NotebookSession, **traits: Any) -> None:
        self._views: dict[str, tuple[Connection, float]] = {}
        self._session = session
        self._run_in_kernel = _kernel_runner()
        self._taking_thread: int | None = None
        self._is_coming, self._lock = False, threading.Lock()
        self._client = SceneClient(session)
        self._end = weakref.finalize(self, session.close)
        with self._taking():
            super().__init__(scene=self._client.scene, camera=self._client.camera, **traits)
        self._client.on_change(self._tell)
        self.on_msg(Viewer._receive)

    def edit(self, **settings: Unpack[Settings]) -> None:
        """Change keys of the scene, named as in `clusterviz.render`: ``widget.edit(cmap="viridis", clim=(0, 1))``.

        Raises
        ------
        SceneError
            A key is unknown or ambiguous, or a value is invalid. The scene stays as it is.
        """
        self._client.edit(with_settings(self._client.scene, settings))
        self._take_news()

    def snapshot(self, size: tuple[int, int] | None = None) -> Image:
        """Return the picture of full quality, as `clusterviz.render` makes it of the widget's scene.

        Parameters
        ----------
        size : width and height in pixels; by default those of the newest view

        Raises
        ------
        SceneError
            An earlier change of the scene was refused.
        ClustervizError
            The picture cannot be drawn, or the session has ended: a rank failed, or the widget was closed.
        """
        picture = self._client.picture(size)
        self._take_news()
        return picture

    def close(self) -> None:
        """End the session with its thread or its ranks, and close all views."""
        self._end()
        super().close()

    @traitlets.validate("camera")
    def _complete_camera(self, proposal: Any) -> dict[str, Any]:
        camera: dict[str, Any] = proposal["value"]
        if self._is_taking:
            return camera
        now = self._client.camera
        if unknown := camera.keys() - now.keys():
            found, allowed = ", ".join(sorted(map(str, unknown))), f"{', '.join(now)}; other keys by widget.edit"
            raise SceneError("unknown key", where="camera", found=found, allowed=allowed)
        completed = with_settings(Scene(), {"camera": {**now, **camera}}).camera
        return completed.model_dump(mode="json", include=set(now))

    @traitlets.observe("camera")
    def _send_camera(self, change: Any) -> None:
        if not self._is_taking:
            self._client.set_camera(change["new"])

    @traitlets.observe("scene")
    def _send_scene(self, change: Any) -> None:
        if not self._is_taking:
            self._client.show(change["new"])

    @property
    def _is_taking(self) -> bool:
        """Whether this thread sets traits to what the session has told."""
        return self._taking_thread == threading.get_ident()

    @contextmanager
    def _taking(self) -> Iterator[None]:
        before, self._taking_thread = self._taking_thread, threading.get_ident()
        try:
            yield
        finally:
            self._taking_thread = before

    def _tell(self) -> None:
        """Let the kernel's thread take the session's news; called from any thread."""
        with self._lock:
            is_coming, self._is_coming = self._is_coming, True
        if not is_coming:
            self._run_in_kernel(self._take_news)

    def _take_news(self) -> None:
        with self._lock:
            self._is_coming = False
        with self._taking():
            self.camera = self._client.camera
            self.scene = self._client.scene

    def _receive(self, content: Any, buffers: Any) -> None:
        view, now = str(content["view"]), time.monotonic()
        if "leaves" in content:
            self._remove(view)
        else:
            connection = self._views[view][0] if view in self._views else self._connect(view)
            self._views[view] = connection, now
            if "text" in content:
                connection.receive(content["text"])
        for each in [name for name, (_, heard) in self._views.items() if now - heard > SILENCE_SECONDS]:
            self._remove(each)

    def _connect(self, view: str) -> Connection:
        def put_text(text: str) -> None:
            self.send({"view": view, "text": text})

        def put_binary(data: bytes) -> None:
            self.send({"view": view}, [data])

        return self._session.connect(put_text, put_binary)

    def _remove(self, view: str) -> None:
        if view in self._views:
            self._views.pop(view)[0].close()


def _kernel_runner() -> Callable[[Callable[[], None]], None]:
    """Return what runs a function in this thread, between the cells of a notebook; without an event loop, nothing."""
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return lambda function: None

    def run(function: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # the kernel ends
            loop.call_soon_threadsafe(function)

    return run
