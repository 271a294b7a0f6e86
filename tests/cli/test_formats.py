"""Formats whose samples are computed or gathered: info describes them, and ranks draw what one rank draws."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import writers

from clusterviz.comm import Channel, run_loopback
from clusterviz.frame import Options, Rendered, render_frame
from clusterviz.image import compare
from clusterviz.scene import scene_of_data
from clusterviz.scene.overrides import with_settings

BLOB = np.exp(-sum((axis - 4.4) ** 2 for axis in np.indices((9, 10, 11))) / 9).astype(np.float32)
UNEVEN = {"level": np.array([0.0, 1, 2, 3, 4, 5, 7, 9, 11]), "lat": np.arange(10.0)[::-1], "lon": np.arange(11.0)}


def series(folder: Path) -> Path:
    folder.mkdir()
    for z, layer in enumerate((1000 * BLOB).astype("i2")):
        writers.save_dicom(writers.dicom(layer, np.array([2.0 * z, 0, 0])), folder / f"{z}.dcm")
    return folder


def pieces(path: Path) -> Path:
    tags = ""
    for name, begin, end in (("a.vti", 0, 5), ("b.vti", 4, 8)):
        extent = f"0 10 0 9 {begin} {end}"
        writers.vti(path.with_name(name), BLOB[begin : end + 1], image='WholeExtent="0 10 0 9 0 8"', piece=extent)
        tags += f'<Piece Extent="{extent}" Source="{name}"/>'
    tags = f'<PImageData WholeExtent="0 10 0 9 0 8" Spacing="1 2 3">{tags}</PImageData>'
    path.write_text(f'<VTKFile type="PImageData">{tags}</VTKFile>')
    return path


FILES: dict[str, tuple[Callable[[Path], Path], str, list[int]]] = {
    "a.nc": (lambda path: writers.netcdf(path, BLOB, UNEVEN), "netcdf", [12, 10, 11]),
    "series": (series, "dicom", [9, 10, 11]),
    "a.pvti": (pieces, "pvti", [9, 10, 11]),
    "a.vtkhdf": (
        lambda path: writers.amr(path, [(2.0, {(0, 0, 0): BLOB}), (1.0, {(6, 6, 6): BLOB[:6, :6, :6]})]),
        "vtkhdf",
        [18, 20, 22],
    ),
}


@pytest.mark.cover
@pytest.mark.parametrize("name", FILES)
def test_a_volume_is_described_and_drawn_by_ranks(name: str, cli: Callable[..., Any], tmp_path: Path) -> None:
    write, kind, shape = FILES[name]
    path = str(write(tmp_path / name))
    found = json.loads(cli("info", path, "--json").out)
    assert (found["format"], found["shape_zyx"]) == (kind, shape)
    scene = with_settings(scene_of_data(path), {"size": (24, 20), "brick": 5})

    def render(channel: Channel) -> Rendered:
        return render_frame(scene, channel, options=Options(device="cpu", check=True))

    (alone,) = run_loopback(1, render)
    together = run_loopback(3, render)[0]
    assert alone.image is not None
    assert together.image is not None
    assert alone.image.max() > 0.1
    assert compare(together.image, alone.image, 1e-5).count == 0
