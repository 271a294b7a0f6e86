"""verify: reports agreement, or which pictures differ and where."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data.grid_writers import vtu

from clusterviz.cli import jobs, verify
from clusterviz.cli.jobs import job_command
from clusterviz.cli.verify import Configuration, compare_with_reference
from clusterviz.content import transfer
from clusterviz.data import open_scene, open_source
from clusterviz.data.store.shards import BrickCodec
from clusterviz.data.store.writer import write_store
from clusterviz.image import write_image
from clusterviz.scene import Scene, scene_of_data

SCENE = ("field:marschner-lobb:20", "--size", "24x18")
WRONG_OWNER = Path(__file__).parent / "wrong_owner.py"


@pytest.mark.fresh
@pytest.mark.gl
def test_pictures_that_agree(cli: Callable[..., Any]) -> None:
    options = ("--ranks", "1,3", "--algorithms", "direct-send", "--transports", "messages,hierarchical")
    outcome = cli(
        "verify", *SCENE, *options, "--bricks", "7", "--modes", "", "--distributions", "coherent", "--all", "--json"
    )
    assert (outcome.status, outcome.err) == (0, "")
    report = json.loads(outcome.out)
    results = report["results"]
    assert report["agree"] is True
    assert len([r for r in results if r["check"] == "picture"]) == 1 + 1 + 1
    assert len([r for r in results if r["check"] == "ownership"]) == 2
    assert len({r["samples"] for r in results if r["check"] == "ownership"}) == 1
    assert all(r["max"] <= 1e-5 and r["problem"] == "" for r in results)
    assert report["reference"]["max"] <= 1e-5


@pytest.mark.fresh
@pytest.mark.gl
def test_pictures_of_a_shared_screen_agree(cli: Callable[..., Any]) -> None:
    """Where the scene itself names a distribution, too, which a shared screen refuses."""
    options = ("--ranks", "3", "--bricks", "64", "--algorithms", "serial", "--transports", "messages")
    options += ("--distributions", "coherent", "--tilings", "scheduled", "-D", "cluster.distribution=dynamic")
    outcome = cli("verify", *SCENE, *options, "--no-ownership", "--no-reference", "--json")
    assert (outcome.status, outcome.err) == (0, "")
    results = json.loads(outcome.out)["results"]
    assert [r["configuration"]["mode"] for r in results] == ["sort-last", "sort-first", "hybrid"]
    assert len({r["samples"] for r in results}) == 1


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize("how", ["twice", pytest.param("missed", marks=pytest.mark.long)])
def test_a_brick_that_two_ranks_own_or_none(how: str, cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(ranks: int, arguments: list[str]) -> list[str]:
        return [*job_command(ranks, [])[:-2], str(WRONG_OWNER), how, *arguments]

    monkeypatch.setattr(jobs, "job_command", wrong)
    options = ("--ranks", "1,2", "--algorithms", "serial", "--bricks", "8", "--distributions", "coherent")
    outcome = cli("verify", *SCENE, *options, "-D", "cluster.brick=8", "--no-reference", "--modes", "")
    assert outcome.status == 1
    assert "ownership, 2 ranks, serial, brick 8: " in outcome.err
    assert "samples instead of" in outcome.err
    assert "the first at row" in outcome.err
    assert "WRONG at row" in outcome.out


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch) -> dict[int, tuple[Any, int]]:
    """What `verify` is told that each number of ranks rendered: (picture, samples)."""
    made = {ranks: (np.full((4, 5, 4), 0.5, np.float32), 100) for ranks in (1, 2, 3)}
    monkeypatch.setattr(verify, "_render", lambda scene, overrides, configuration, folder: made[configuration.ranks])
    return made


def run_faked(cli: Callable[..., Any], *more: str) -> Any:
    alone = ("--transports", "messages", "--distributions", "coherent", "--bricks", "64", "--modes", "")
    return cli("verify", *SCENE, "--ranks", "1,2,3", "--algorithms", "tree", *alone, "--no-reference", *more)


def test_one_wrong_pixel_is_named(cli: Callable[..., Any], pictures: dict[int, tuple[Any, int]]) -> None:
    assert run_faked(cli).status == 0
    pictures[3][0][2, 1, 0] += 2e-5
    outcome = run_faked(cli)
    assert outcome.status == 1
    assert "picture, 3 ranks, tree, brick 64: max 2e-05" in outcome.err
    assert "row 2, column 1" in outcome.err
    assert "2 ranks" not in outcome.err


def test_one_sample_too_many_is_named(cli: Callable[..., Any], pictures: dict[int, tuple[Any, int]]) -> None:
    pictures[2] = (pictures[2][0], 101)
    outcome = run_faked(cli)
    assert outcome.status == 1
    for check in ("picture", "ownership"):
        assert outcome.err.count(f"{check}, 2 ranks, tree, brick 64: 101 samples instead of 100") == 1
    # Rays that end where little light is left do so by what their own rank has drawn.
    assert "picture" not in run_faked(cli, "-D", "quality.early_termination=0.01").err.split("disagree")[1]


def test_ways_that_a_scene_refuses_are_left_out(cli: Callable[..., Any], pictures: dict[int, tuple[Any, int]]) -> None:
    """Rays that start by the last frame are not drawn with a shared screen."""
    options = ("--ranks", "1,3", "--algorithms", "tree", "--no-reference", "--json")
    outcome = cli("verify", *SCENE, *options, "-D", "quality.frame_coherence=true")
    assert (outcome.status, outcome.err) == (0, "")
    assert {each["configuration"]["mode"] for each in json.loads(outcome.out)["results"]} == {"sort-last"}


def test_every_setting_occurs_in_the_few_that_are_tried() -> None:
    ways = ["serial", "tree", "direct-send"], [64, 8], ["messages", "shared", "hierarchical"], [("hybrid", "auto")]
    every = verify._configurations([1, 2, 3, 7], *ways, verify.DISTRIBUTIONS)
    few = verify.covering_subset(every)
    assert {setting for each in few for setting in each.settings} == {s for each in every for s in each.settings}
    assert [(each.ranks, each.brick) for each in few[:2]] == [(1, 64), (1, 8)]
    assert sum(each.ranks for each in few) < sum(each.ranks for each in every) / 10
    assert verify.covering_subset(few) == few


def test_what_is_going_to_be_done_is_said_and_left_out_when_quiet(
    cli: Callable[..., Any], pictures: dict[int, tuple[Any, int]]
) -> None:
    assert run_faked(cli).err.startswith(
        "verify: 3 of 3 combinations (--all: every one)\nverify: 6 renders, on 1, 2, 3 "
    )
    quiet = cli("verify", "-q", *SCENE, "--ranks", "1,2", "--no-reference")
    assert (quiet.status, quiet.out, quiet.err) == (0, "", "")


def test_one_rank_needs_one_algorithm() -> None:
    found = verify._configurations([1, 2], ["tree", "serial"], [8], ["messages", "shared", "hierarchical"])
    alone, two = [Configuration(1, "tree", 8)], [Configuration(2, "tree", 8), Configuration(2, "serial", 8)]
    assert found == [*alone, *two, Configuration(2, "auto", 8, "shared")]


def test_three_ranks_make_two_nodes() -> None:
    found = verify._configurations([3], ["tree"], [8], ["hierarchical"])
    assert found == [Configuration(3, "auto", 8, "hierarchical")]


@pytest.mark.fresh
def test_a_job_that_fails_says_why(cli: Callable[..., Any], tmp_path: Path) -> None:
    outcome = cli("verify", str(tmp_path / "none.npy"), "--ranks", "2", "--bricks", "64", "--json")
    assert outcome.status == 2
    assert "on 2 ranks: " in outcome.err
    assert "none.npy: no such file" in outcome.err
    assert outcome.err.count("\n") == 1


def test_mpirun_is_the_one_beside_this_python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert job_command(1, ["info"]) == [sys.executable, "-m", "clusterviz", "info"]
    for folder in ("venv", "path"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mpirun").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "venv/python"))
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    assert job_command(2, [])[:3] == [str(tmp_path / "venv/mpirun"), "-n", "2"]
    (tmp_path / "venv/mpirun").unlink()
    assert job_command(2, [])[0] == str(tmp_path / "path/mpirun")


def test_a_launcher_that_is_named_starts_every_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUSTERVIZ_LAUNCHER", "srun --mpi=pmix --label='a b'")
    for ranks in (1, 3):
        assert job_command(ranks, ["info"])[:5] == ["srun", "--mpi=pmix", "--label=a b", "-n", str(ranks)]


def test_samples_are_counted_where_no_surface_ends_rays() -> None:
    for opacity, fixed in ((0.4, True), (1.0, False), ([[0.0, 0.1], [1.0, 1.0]], False)):
        scene = Scene.model_validate({"meshes": [{"path": "a.ply", "scalars": "s", "opacity": opacity}]})
        assert verify._has_fixed_sample_count(scene) == fixed


def test_slabs_cut_at_the_faces_of_bricks_are_compared_among_equal_bricks(monkeypatch: pytest.MonkeyPatch) -> None:
    made = {8: np.full((4, 5, 4), 0.5, np.float32), 16: np.full((4, 5, 4), 0.6, np.float32)}
    monkeypatch.setattr(
        verify, "_render", lambda scene, overrides, configuration, folder: (made[configuration.brick], 1)
    )
    ways = [Configuration(ranks, "tree", brick) for brick in made for ranks in (1, 2)]
    assert not any(result.problem for result in verify.run_all("scene", [], ways, 1e-5, (), splits=True))
    assert any(result.problem for result in verify.run_all("scene", [], ways, 1e-5, ()))


def test_depth_is_compared_with_the_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a share of the largest, where it is finite."""

    def job(ranks: int, arguments: list[str], **_: Any) -> None:
        depth = np.array([[20.0, 10.0 * ranks, np.inf]], np.float32)
        write_image(arguments[3], np.zeros((1, 3, 4), np.float32), None, layers={"depth": depth})
        Path(arguments[5]).write_text(json.dumps({"frames": [{"per_rank": [{"samples": 1, "samples_estimate": 0}]}]}))

    monkeypatch.setattr(verify, "run_job", job)
    ways, layers = [Configuration(ranks, "tree", 8) for ranks in (1, 2)], ["image.layers=[depth]"]
    same, other = verify.run_all("field:gaussian:8", layers, ways, 1e-5, ())
    assert (same.problem, other.max, other.first_wrong_pixel) == ("", 0.5, (0, 1))


def test_scene_for_groups_of_ranks_is_compared_with_the_reference_on_one_rank() -> None:
    scene = scene_of_data("field:gaussian:9", ["image.size=[8,6]", "cluster.mode=hybrid", "cluster.groups=2"])
    assert compare_with_reference(scene).max <= 1e-5


@pytest.mark.parametrize("part", ["colour_points", "opacity_points", "TransferFunction"])
def test_a_wrong_transfer_function_is_found(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference has its own, so that a mistake in what the renderer uses is none in both."""
    right = getattr(transfer, part)

    def wrong(*given: Any, **named: Any) -> Any:
        found = right(*given, **named)
        if part == "TransferFunction":
            return replace(found, unit_distance=1.05 * found.unit_distance)
        return found[0], 0.95 * found[1]

    monkeypatch.setattr(transfer, part, wrong)
    scene = scene_of_data(
        "field:gaussian:9", ["image.size=[8,6]", "volumes.0.cmap=viridis", "volumes.0.opacity=linear"]
    )
    assert compare_with_reference(scene).max > 1e-3


def test_levels_are_compared_with_the_field_that_they_stand_for(tmp_path: Path) -> None:
    write_store(open_source("field:marschner-lobb:20"), path := tmp_path / "a.ome.zarr", BrickCodec("zstd"), 8)
    settings = ["automatic=false", "volumes.0.detail={level: 1}", "opacity=0.3", "image.size=[24,18]"]
    assert compare_with_reference(open_scene(path, settings)).max <= 1e-5
    assert "no gradients of coarser levels" in str(compare_with_reference(open_scene(path, [*settings, "shade=true"])))


def test_scene_with_a_shader_is_not_compared_with_the_reference() -> None:
    scene = scene_of_data("field:gaussian:9", ["volumes.0.shader=mine.glsl"])
    assert "it does not read shaders such as" in str(compare_with_reference(scene))


def test_grids_are_compared_with_the_reference(tmp_path: Path) -> None:
    path = vtu(tmp_path / "a.vtu")
    for settings in (["array=kind"], ["array=f", "shade=true"]):
        scene = open_scene(path, [*settings, "opacity=0.5", "image.size=[24,18]"])
        assert compare_with_reference(scene).max <= 1e-5


def test_sub_images_of_a_lens_are_compared_with_its_eye_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both beside the pinhole's float64 reference."""
    monkeypatch.setattr(verify, "EYE_POINTS", 8)
    scene = scene_of_data("field:gaussian:9", ["image.size=[16,12]", "opacity=0.5", "camera.aperture=0.2"])
    found = compare_with_reference(scene)
    assert found.max <= 1e-5
    assert found.lens is not None
    assert 1e-4 < found.lens[1] < found.lens[0] < 0.2
    assert "from 8 eye points at 16 × 12" in str(found)
