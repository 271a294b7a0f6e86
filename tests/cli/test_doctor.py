from __future__ import annotations

import json
import mmap
import os
from pathlib import Path

import pytest

from clusterviz.cli.doctor import command, examine, problems_of
from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.comm.library import check_launcher
from clusterviz.comm.mpi import remove_segments
from clusterviz.comm.placement import SIZE_VARIABLES
from clusterviz.errors import DeviceError


@pytest.mark.gl
def test_every_rank_is_examined() -> None:
    report = run_loopback(3, examine)[0]
    assert [machine.rank for machine in report.ranks] == [0, 1, 2]
    assert report.size == 3
    assert all(machine.opengl and machine.opengl.max_3d_texture >= 256 for machine in report.ranks)
    assert problems_of(report) == []


@pytest.mark.gl
def test_json_holds_what_a_script_asks_for(capsys: pytest.CaptureFixture[str]) -> None:
    command(json=True)
    (machine,) = json.loads(capsys.readouterr().out)["ranks"]
    assert machine["opengl"]["renderer"]
    assert machine["egl_devices"][machine["egl_device"]]
    assert int(machine["threads"]["LP_NUM_THREADS"]) >= 1
    assert machine["memory"]["total_bytes"] > 0


@pytest.mark.gl
def test_table_names_the_renderer(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    report = examine(LoopbackChannel())
    command()
    opengl = report.ranks[0].opengl
    assert opengl
    assert opengl.renderer in capsys.readouterr().out


def test_no_egl_prints_the_rest_then_names_the_packages(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clusterviz.gl.devices.find_library", lambda name: None)
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(DeviceError, match=r"no rank can draw with OpenGL: .*libegl1") as raised:
        command(json=True)
    assert raised.value.exit_status == 1
    (machine,) = json.loads(capsys.readouterr().out)["ranks"]
    assert (machine["opengl"], machine["egl_device"]) == (None, None)
    assert "libegl1" in machine["problem"]
    with pytest.raises(DeviceError):
        command()
    assert "none" in capsys.readouterr().out


def test_launcher_that_started_several_programs_of_one_rank_is_a_loud_failure(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        check_launcher("Open MPI v4.1.4", 1, {SIZE_VARIABLES[1]: "4"})

    monkeypatch.setattr("clusterviz.cli.doctor.open_channel", refuse)
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(DeviceError, match="4 processes"):
        command()
    assert "WARNING" in capsys.readouterr().out


@pytest.mark.gl
@pytest.mark.mpi(ranks=[2])
def test_ranks_under_mpirun_see_each_other(comm: object) -> None:
    from clusterviz.comm import open_channel

    report = examine(open_channel())
    assert [machine.local_rank for machine in report.ranks] == [0, 1]
    assert report.warning == ""
    assert report.launcher != "none"


def test_clean_removes_what_nobody_has_mapped(tmp_path: Path) -> None:
    left, young, used, other = (tmp_path / name for name in ("mpich_shm_a", "mpich_shm_b", "mpich_shm_c", "mine"))
    for path in (left, young, used, other):
        path.write_bytes(bytes(4096))
        if path != young:
            os.utime(path, (0, 0))
    with used.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ):
        assert remove_segments(tmp_path) == [left]
    assert sorted(tmp_path.iterdir()) == [other, young, used]
