"""The examples of jobs, and the program of the how-to, as a user starts them."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clusterviz import jobs
from clusterviz.comm import Channel, run_loopback

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "jobs"


@pytest.mark.parametrize(("ranks", "schedule"), [(1, "random"), (3, "local")])
def test_product_of_matrices(schedule: str, ranks: int) -> None:
    """Of sides that blocks do not divide; close to NumPy's product."""
    multiply = runpy.run_path(str(EXAMPLES / "multiply_matrices.py"))["multiply"]
    rng = np.random.default_rng(1)
    left, right = rng.uniform(-1, 1, (70, 50)), rng.uniform(-1, 1, (50, 90))

    def check(channel: Channel) -> None:
        with jobs.cluster(channel) as cluster:
            arrays = []
            for values, sides in ((left, (1, 24, 20)), (right, (1, 20, 32)), (np.zeros((70, 90)), (1, 24, 32))):
                arrays.append(cluster.array((1, *values.shape), np.float32, sides))
                for index, block in arrays[-1].own_blocks():
                    block[...] = values[None][tuple(map(slice, *arrays[-1].box(index)))]
                arrays[-1].sync()
            run = multiply(cluster, *arrays, schedule)
            assert run.blocks.sum() == 9
            assert (run.bytes_fetched.sum() > 0) == (ranks > 1)
            np.testing.assert_allclose(arrays[2][0], left @ right, atol=1e-5)

    run_loopback(ranks, check)


def test_path_tracing_writes_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, output = tmp_path / "scene.yaml", tmp_path / "traced.png"
    scene.write_text("volumes: [{path: 'field:gaussian:17', cmap: gray, opacity: 0.1}]\nimage: {size: [24, 16]}")
    arguments = [scene, "-o", output, "--samples", 2, "--environment", 1, 1, 1]
    monkeypatch.setattr(sys, "argv", ["trace_paths.py", *map(str, arguments)])
    runpy.run_path(str(EXAMPLES / "trace_paths.py"), run_name="__main__")
    assert "2 samples, standard error 0." in capsys.readouterr().out
    with Image.open(output) as picture:
        assert picture.size == (24, 16)
        assert np.ptp(np.asarray(picture)) > 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trace_paths.py", "missing.yaml"], "missing.yaml: cannot be read: No such file"),
        (["multiply_matrices.py", "--size", "0"], "no shape of an array; found (1, 0, 0)"),
        (["reconstruct_ct.py", "views.tif", "--geometry", "missing.yaml"], "missing.yaml: cannot be read"),
    ],
)
def test_wrong_input_is_one_message(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as raised:
        runpy.run_path(str(EXAMPLES / arguments[0]), run_name="__main__")
    assert raised.value.code == 2
    assert message in capsys.readouterr().err
