"""`clusterviz view`: show a scene or a data file in the browser, drawn by the ranks of a job."""

from __future__ import annotations

import getpass
import os
import secrets
import socket
import sys
import warnings
from collections.abc import Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, NoReturn
from urllib.parse import quote

import typer

from clusterviz.cli.arguments import Define, DeviceOption, PresetOption, SceneArgument, Size, overrides_of, parse_device
from clusterviz.cli.console import print_info
from clusterviz.cli.instrumentation import start
from clusterviz.cli.jobs import OVERSUBSCRIBE, job_command
from clusterviz.comm import agree
from clusterviz.comm.placement import launched
from clusterviz.data import FILE_AND_DATASET, open_scene
from clusterviz.data.remote import is_url
from clusterviz.errors import ClustervizError, InputError, installation
from clusterviz.frame import Options
from clusterviz.viewer.pace import Pace
from clusterviz.viewer.render_loop import RenderLoop
from clusterviz.viewer.saving import OpenedAs
from clusterviz.viewer.session import Session

TOKEN_VARIABLE = "CLUSTERVIZ_TOKEN"
"""Environment variable with the token of the URL; without it a random one is made."""
SHORTEST_TOKEN = 16
REMOTE_VARIABLES = ("SSH_CONNECTION", "SLURM_JOB_ID", "PBS_JOBID")


def command(
    context: typer.Context,
    scene: SceneArgument,
    define: Define = None,
    preset: PresetOption = None,
    size: Size = None,
    ranks: Annotated[
        int | None, typer.Option(min=1, help="Start so many ranks with mpirun; default: those of the launcher, or one.")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free one.")] = 8787,
    host: Annotated[str, typer.Option(help="Address on which the page is served.")] = "127.0.0.1",
    budget: Annotated[
        float, typer.Option(min=1, metavar="MS", help="Time of a picture while the view moves, milliseconds.")
    ] = 50.0,
    shared: Annotated[bool, typer.Option("--shared", help="Let all browsers steer, not one at a time.")] = False,
    end_alone: Annotated[bool, typer.Option("--end-alone", help="End after the last browser has left.")] = False,
    origin: Annotated[
        list[str] | None, typer.Option(metavar="URL", help="Origin of pages behind a proxy: https://hub.example.")
    ] = None,
    root: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DIR",
            help="Folder whose files browsers may open, beside that of the scene; /: all files, and all addresses.",
        ),
    ] = None,
    device: DeviceOption = None,
) -> None:
    """Show a scene or a data file in the browser; the ranks of a job draw it."""
    try:
        import simplejpeg  # noqa: F401

        from clusterviz.viewer.server import Server, open_socket
    except ImportError as error:
        raise ClustervizError(f"view needs {error.name}: {installation('view')}") from None
    if ranks is not None and launched():
        raise InputError("the launcher sets the number of ranks", where="--ranks", found=ranks, allowed="no --ranks")
    token, folders = _token(), _folders_of(scene, root or [])
    if ranks is not None and ranks > 1:
        open_socket(host, port).close()  # a port in use is found before the job starts
        _start_job(ranks)
    channel, _ = start()
    with agree(channel, 0, "scene"):
        overrides, device_choice = overrides_of(define, size), parse_device(device)
        opened = open_scene(scene, overrides, preset)
    with agree(channel, 0, "port"):
        listening = open_socket(host, port) if channel.rank == 0 else None
    if listening is not None and not _is_loopback(host):
        warnings.warn(f"{host}: the page is served by HTTP, so others on the network can read its token", stacklevel=1)
    options = Options(device_choice, debug=bool(context.obj["debug"]))
    loop = RenderLoop(opened, channel, options=options, opened_as=OpenedAs(scene, tuple(overrides), preset))
    if listening is None:
        loop.follow()
        return
    session = Session(loop.scene, loop.content, channel.size, budget, shared, end_alone, folders=folders)
    server, reason = Server(session, listening, token, origins=tuple(origin or ())), "the job has failed"
    server.start()
    try:
        _announce(host, server.port, token)
        loop.lead(session, Pace(budget / 1000))
        reason = "nobody was watching"
    except KeyboardInterrupt:
        reason = "the job was interrupted"
        raise
    finally:
        session.close(reason)
        server.close()


def _start_job(ranks: int) -> NoReturn:
    """Replace this process by a job of the same command line."""
    arguments = list(sys.argv[1:])
    place = next(n for n, each in enumerate(arguments) if each.partition("=")[0] == "--ranks")
    del arguments[place : place + 1 + ("=" not in arguments[place])]
    command_line = job_command(ranks, arguments)
    os.execvpe(command_line[0], command_line, {**OVERSUBSCRIBE, **os.environ})


def _token() -> str:
    token = os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(24)
    try:
        token.encode()
    except UnicodeEncodeError:
        raise InputError("not UTF-8", where=TOKEN_VARIABLE, allowed="a text") from None
    if len(token) < SHORTEST_TOKEN:
        found, allowed = f"{len(token)} characters", f"{SHORTEST_TOKEN} or more, which nobody can guess"
        raise InputError("too short", where=TOKEN_VARIABLE, found=found, allowed=allowed)
    return token


def _folders_of(scene: str, more: Sequence[Path]) -> list[Path] | None:
    """Return the folders of files that clients may name: that of a scene or a data file, and more; None: any file."""
    if any(folder.resolve() == Path("/") for folder in more):
        return None
    for folder in more:
        if not folder.is_dir():
            raise InputError("no such folder", where="--root", found=folder)
    if is_url(scene) or scene.startswith("field:"):
        return list(more)
    dataset = FILE_AND_DATASET.fullmatch(scene)
    file = Path(dataset[1] if dataset else scene)
    return [file if file.is_dir() else file.parent, *more]


def _announce(host: str, port: int, token: str) -> None:
    """Print the URL, and how to reach it from elsewhere."""
    name = "127.0.0.1" if _is_loopback(host) else socket.gethostname() if host in ("0.0.0.0", "::") else host
    print(f"http://{name}:{port}/?token={quote(token, safe='')}", flush=True)
    if _is_loopback(host) and any(os.environ.get(name) for name in REMOTE_VARIABLES):
        where = socket.gethostname()
        print_info(f"from another machine, first:   ssh -L {port}:127.0.0.1:{port} {getpass.getuser()}@{where}")


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
