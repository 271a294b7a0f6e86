"""`clusterviz verify`: compare the pictures of a scene over rank counts, algorithms, transports and brick sizes.

Each configuration is a separate job. By default a small set covers every setting, and as many pairs of settings as
possible, since few faults need more than a pair. Every picture is compared with the first one. The ownership check
repeats this with a nearly transparent scene, in which no slab of a ray hides another: a slab owned by two ranks, or by
none, changes the number of samples and the picture. Last, the picture is compared with the float64 reference at a small
size.
"""

from __future__ import annotations

import itertools
import json as json_text
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, get_args

import numpy as np
import typer

from clusterviz.cli.arguments import Define, SceneArgument, Size, overrides_of, parse_counts, parse_names
from clusterviz.cli.console import Verbosity, show_progress, verbosity
from clusterviz.cli.jobs import refuse_launcher, run_job
from clusterviz.comm import LoopbackChannel
from clusterviz.comm.placement import RANKS_PER_NODE_VARIABLE, granted_cores
from clusterviz.content.contract import Entry
from clusterviz.content.reference_data import become, data_of, reference_data, samples_of, why_unchecked
from clusterviz.content.table import own_entries
from clusterviz.data import open_scene
from clusterviz.data.levels import MixedSource
from clusterviz.data.source import levels_of
from clusterviz.errors import ClustervizError
from clusterviz.frame import Options, Run, prepare, render_frame
from clusterviz.image import compare, read_image
from clusterviz.image.compare import Difference
from clusterviz.image.files import Pixels
from clusterviz.reference import render_reference
from clusterviz.scene import Cluster, Scene
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.overrides import with_settings

WIDTH = 128
EYE_POINTS = 64
"""Eye points with which the sub-images of a lens are compared."""
BENT_WIDTH = 12
"""Pixels of a row where rays bend, as the reference follows each ray by itself."""
MAX_BYTES = 1 << 30
"""Largest volume to compare; the reference holds the whole volume in memory."""


@dataclass(frozen=True)
class ReferenceComparison:
    """Difference between a picture and the reference.

    `max`, `rms`: maximum and root mean square of the difference. `lens`: maximum and root mean square of the difference
    between the sub-images of a lens, and `EYE_POINTS` of it; the reference is of the pinhole then.
    """

    size: tuple[int, int]  # (width, height) of both pictures
    max: float = 0.0
    rms: float = 0.0
    skipped: str = ""  # the reason for no comparison, or ""
    lens: tuple[float, float] | None = None

    def __str__(self) -> str:
        at = f"{self.size[0]} × {self.size[1]}"
        text = f"reference  max {self.max:.2e}, rms {self.rms:.2e} from float64 at {at}"
        text = f"reference  left out: {self.skipped}" if self.skipped else text
        if self.lens is None:
            return text
        return f"{text}\nlens       max {self.lens[0]:.2e}, rms {self.lens[1]:.2e} from {EYE_POINTS} eye points at {at}"


def compare_with_reference(scene: Scene) -> ReferenceComparison:
    """Render a scene on one rank and by the reference, with the same step, and compare both.

    The difference is caused by float32 pixels, `quality.filter` and `quality.early_termination` only. A lens is
    replaced by a pinhole, and its own error measured apart.
    """
    width, height = scene.image.size
    most = BENT_WIDTH if scene.refracts else WIDTH
    size = (min(width, most), max(1, round(height * min(width, most) / width)))
    if scene.camera.aperture:
        found = compare_with_reference(with_settings(scene, {"aperture": 0.0}))
        return replace(found, lens=_compare_with_eye_points(scene, size))
    if why := why_unchecked(scene):
        return ReferenceComparison(size, skipped=f"it {why}")
    made = become(scene)
    sources = samples_of(scene, made)
    counts = [math.prod(source.grid.shape_zyx) for source in sources]
    if sum(n * source.dtype.itemsize for n, source in zip(counts, sources, strict=True)) > MAX_BYTES:
        limit = f"the {MAX_BYTES >> 30} GiB it may hold in memory"
        return ReferenceComparison(size, skipped=f"{sum(counts)} samples are more than {limit}")
    one_rank = scene.cluster.model_copy(update={"mode": "sort-last", "groups": None})
    small = scene.model_copy(update={"image": scene.image.model_copy(update={"size": size}), "cluster": one_rank})
    rendered = render_frame(small, LoopbackChannel())
    data = reference_data(_with_levels(rendered.scene, data_of(rendered.scene, made)))
    expected = render_reference(rendered.scene, data.grids, data.voxels, **data.more)
    difference = compare(rendered.image, expected)  # type: ignore[arg-type]
    return ReferenceComparison(size, difference.max, difference.rms)


def _compare_with_eye_points(scene: Scene, size: tuple[int, int]) -> tuple[float, float]:
    """Return maximum and root mean square of the difference between a scene's lens and many eye points of it."""
    changes: tuple[dict[str, Any], ...] = ({}, {"lens": {"eye_points": EYE_POINTS}})
    both = [with_settings(scene, {"size": size, "mode": "sort-last", "groups": None} | each) for each in changes]
    lens, eyes = (render_frame(each, LoopbackChannel()).image for each in both)
    assert lens is not None
    assert eyes is not None
    difference = compare(lens, eyes)
    return difference.max, difference.rms


def _with_levels(scene: Scene, data: list[tuple[Entry, Any]]) -> list[tuple[Entry, Any]]:
    """Return entries with their data, and those of stores at the levels that a picture uses, on the finest grid."""
    if all(getattr(entry.section, "detail", "full") == "full" for entry, _ in data):
        return data
    work, _ = prepare(Run(LoopbackChannel(), Options()), scene)
    assert work.plan is not None, "there is a volume"
    layers, found = iter(work.plan.content.volume_layers), list[tuple[Entry, Any]]()
    for entry, one in data:
        layer = next(layers) if entry.section.drawn_as == "samples" else None
        levels = levels_of(one) if layer else None
        if layer and layer.levels is not None and levels is not None:
            one = MixedSource(levels, layer.levels, 0)
        found.append((entry, one))
    return found


ALGORITHMS = [name for name in get_args(Cluster.model_fields["compositing"].annotation) if name != "auto"]
TRANSPORTS = [name for name in get_args(Cluster.model_fields["transport"].annotation) if name != "auto"]
DEFAULT_ALGORITHMS = "serial,tree,direct-send,binary-swap"
MODES = [name for name in get_args(Cluster.model_fields["mode"].annotation) if name not in ("auto", "sort-last")]
TILINGS = list(get_args(Cluster.model_fields["tiling"].annotation))
DISTRIBUTIONS = [name for name in get_args(Cluster.model_fields["distribution"].annotation) if name != "auto"]
SIMULATED_RANKS_PER_NODE = 2
"""Ranks of a simulated node in checks of the hierarchical transport, so that one machine has several nodes."""
FAINT_OPACITY = "1e-6"
"""Opacity in the ownership check: after 10⁴ slabs the transmittance is still 99 %."""
FAINT_TOLERANCE = 1e-4
"""Tolerance of the ownership check relative to the brightest pixel; one of 10³ slabs is ten times as much."""


@dataclass(frozen=True)
class Configuration:
    """Configuration of one render."""

    ranks: int
    algorithm: str
    brick: int
    transport: str = "messages"
    mode: str = "sort-last"
    tiling: str = "auto"
    distribution: str = "coherent"

    @property
    def method(self) -> str:
        """Mode and tiling of a shared screen, else algorithm or transport, and the distribution."""
        if self.mode != "sort-last":
            return f"{self.mode}, {self.tiling}"
        compositing = self.algorithm if self.transport == "messages" else self.transport
        return compositing if self.distribution == "coherent" else f"{compositing}, {self.distribution}"

    @property
    def settings(self) -> frozenset[tuple[str, object]]:
        """Settings that the configuration covers; a single rank covers no work sharing."""
        found: dict[str, object] = {"ranks": self.ranks, "brick": self.brick}
        if self.ranks > 1 and self.mode == "sort-last":
            found |= {"compositing": (self.algorithm, self.transport), "distribution": self.distribution}
        elif self.ranks > 1:
            found |= {"screen": (self.mode, self.tiling)}
        return frozenset(found.items())

    def __str__(self) -> str:
        return f"{self.ranks} rank{'s' * (self.ranks > 1)}, {self.method}, brick {self.brick}"


@dataclass(frozen=True)
class Result:
    """Comparison of a picture with the first one.

    `max`, `rms`: maximum and root mean square of the difference; for ownership relative to the brightest pixel.
    """

    check: str  # "picture" or "ownership"
    configuration: Configuration
    max: float
    rms: float
    tolerance: float  # the largest difference allowed
    first_wrong_pixel: tuple[int, int] | None  # (row, column), or None if no pixel exceeds the tolerance
    samples: int
    problem: str  # the problem found, or ""


def command(
    scene: SceneArgument,
    ranks: Annotated[str, typer.Option(metavar="N,N,…", help="Numbers of ranks.")] = "1,2,3,4,7",
    algorithms: Annotated[
        str, typer.Option(metavar="A,A,…", help="Compositing algorithms, or all.")
    ] = DEFAULT_ALGORITHMS,
    transports: Annotated[
        str, typer.Option(metavar="T,T,…", help="Transports; messages with each algorithm.")
    ] = "messages,shared,hierarchical",
    modes: Annotated[
        str, typer.Option(metavar="M,M,…", help="Modes that share the screen, beside sort-last.")
    ] = "sort-first,hybrid",
    tilings: Annotated[str, typer.Option(metavar="T,T,…", help="Tilings of each of them.")] = "auto",
    distributions: Annotated[str, typer.Option(metavar="D,D,…", help="Distributions of bricks over ranks.")] = ",".join(
        DISTRIBUTIONS
    ),
    bricks: Annotated[
        str | None, typer.Option(metavar="N,N,…", help="Brick sizes; default: the scene's, and a smaller one.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="All combinations instead of a few that cover each setting.")
    ] = False,
    define: Define = None,
    size: Size = None,
    tolerance: Annotated[float, typer.Option(min=0, help="Largest difference between two pictures.")] = 1e-5,
    ownership: Annotated[bool, typer.Option(help="Check that each slab of a ray has one owner.")] = True,
    reference: Annotated[bool, typer.Option(help="Compare with the float64 reference too, 128 pixels wide.")] = True,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Render a scene on several rank counts (starting mpirun by itself), and compare the pictures."""
    refuse_launcher("verify")
    overrides = overrides_of(define, size)
    opened = open_scene(scene, overrides)
    configurations = _configurations(
        parse_counts(ranks, 1, "--ranks"),
        ALGORITHMS if algorithms == "all" else parse_names(algorithms, [*ALGORITHMS, "auto"], "--algorithms"),
        parse_counts(bricks, 2, "--bricks") if bricks else _default_bricks(opened),
        parse_names(transports, TRANSPORTS, "--transports"),
        [
            (mode, tiling)
            for mode in (parse_names(modes, MODES, "--modes") if modes else ())
            for tiling in parse_names(tilings, TILINGS, "--tilings")
        ],
        parse_names(distributions, DISTRIBUTIONS, "--distributions"),
    )
    if opened.quality.frame_coherence:
        # Frame coherence is refused with a shared screen.
        configurations = [each for each in configurations if each.mode == "sort-last"]
    if opened.refracts:
        # Rays that bend may need any brick, so that ranks share the screen only.
        shared = [
            each if each.mode == "sort-first" else Configuration(each.ranks, "auto", each.brick, "auto", "sort-first")
            for each in configurations
        ]
        configurations = list(dict.fromkeys(shared))
    splits = opened.quality.borders == "split"
    faint = [
        f"{entry.key}.{setting}"
        for entry in own_entries(opened)
        for setting in (f"opacity={FAINT_OPACITY}", *entry.kind.faint)
    ]
    chosen = configurations if every else covering_subset(configurations)
    announce = _silent if json or verbosity() is Verbosity.QUIET else _announce
    announce(f"{len(chosen)} of {len(configurations)} combinations" + (" (--all: every one)" if not every else ""))
    results = run_all(
        scene,
        overrides,
        chosen,
        tolerance,
        faint if ownership else (),
        splits,
        announce,
        _has_fixed_sample_count(opened),
    )
    comparison = compare_with_reference(opened) if reference and opened.has_content else None
    if json:
        _print_json(results, comparison)
    elif verbosity() is not Verbosity.QUIET:
        _print_table(results, comparison)
    wrong = [f"{result.check}, {result.configuration}: {result.problem}" for result in results if result.problem]
    if wrong:
        raise ClustervizError("the pictures disagree:\n  " + "\n  ".join(wrong))


def _has_fixed_sample_count(scene: Scene) -> bool:
    """Return whether the number of samples is independent of the configuration: no ray starts late or ends early."""
    quality = scene.quality
    changing = quality.frame_coherence or quality.early_termination > 0 or quality.max_error is not None
    # Rays end at opaque surfaces, but not those of ranks behind them.
    changing |= any(one.may_be_opaque for one in scene.entries.values())
    return not changing and all(BLEND_MODES[one.blending].absorbs for one in scene.drawn_as("samples").values())


def _announce(text: str) -> None:
    print(f"verify: {text}", file=sys.stderr, flush=True)


def _silent(text: str) -> None:
    """Ignore a progress message."""


def _configurations(
    ranks: Sequence[int],
    algorithms: Sequence[str],
    bricks: Sequence[int],
    transports: Sequence[str],
    shared: Sequence[tuple[str, str]] = (),
    distributions: Sequence[str] = ("coherent",),
) -> list[Configuration]:
    """Return all distinct configurations.

    A single rank composites nothing, a single node has no hierarchy, and two ranks form no groups.
    """
    result = []
    for brick in bricks:
        for count in ranks:
            ways = [(algorithm, "messages") for algorithm in algorithms if "messages" in transports]
            ways += [("auto", name) for name in transports if name == "shared"]
            if count > SIMULATED_RANKS_PER_NODE:
                ways += [("auto", name) for name in transports if name == "hierarchical"]
            if count == 1:
                result.append(Configuration(1, algorithms[0], brick))
            else:
                result += [
                    Configuration(count, name, brick, transport, distribution=distribution)
                    for (name, transport), distribution in itertools.product(ways, distributions)
                ]
            result += [
                Configuration(count, "auto", brick, "auto", mode, tiling)
                for mode, tiling in shared
                if count > (2 if mode == "hybrid" else 1)
            ]
    return result


def covering_subset(configurations: Sequence[Configuration]) -> list[Configuration]:
    """Return a few configurations that cover all settings, chosen greedily.

    The first of each brick size come first. Each next one has the most uncovered settings, then the most uncovered
    pairs of settings per rank, then the smallest bricks.
    """
    chosen = list({each.brick: each for each in reversed(configurations)}.values())[::-1]
    missing = frozenset[tuple[str, object]]().union(*(each.settings for each in configurations))
    missing -= frozenset[tuple[str, object]]().union(*(each.settings for each in chosen))
    pairs = {pair for each in chosen for pair in _pairs(each)}

    def worth(each: Configuration) -> tuple[float, ...]:
        return len(each.settings & missing), len(_pairs(each) - pairs) / each.ranks, -each.brick

    while missing:
        best = max(configurations, key=worth)
        chosen.append(best)
        missing -= best.settings
        pairs |= _pairs(best)
    return chosen


def _pairs(configuration: Configuration) -> set[frozenset[tuple[str, object]]]:
    return {frozenset(pair) for pair in itertools.combinations(configuration.settings, 2)}


def _default_bricks(scene: Scene) -> list[int]:
    """Return the scene's brick size, and a smaller one that gives each rank several bricks."""
    if not scene.drawn_as("samples"):
        return [scene.cluster.brick, max(2, scene.cluster.brick * 3 // 4)]
    if scene.cluster.largest_brick is not None:
        return [scene.cluster.brick, scene.cluster.largest_brick]  # of several sizes, and of one
    side = max(samples_of(scene, {})[0].grid.shape_zyx)
    return list(dict.fromkeys((scene.cluster.brick, max(2, min(side // 5, scene.cluster.brick * 3 // 4)))))


def run_all(
    scene: str,
    overrides: list[str],
    configurations: list[Configuration],
    tolerance: float,
    faint: Sequence[str],
    splits: bool = False,
    announce: Callable[[str], None] = _silent,
    compare_samples: bool = False,
) -> list[Result]:
    """Render all configurations, and compare each picture with the first.

    Parameters
    ----------
    scene, overrides : as given to `clusterviz render`
    configurations : at least one configuration
    tolerance : the largest difference of two pictures
    faint : settings of the ownership check, which runs once for each number of ranks, brick size, mode, tiling and
        distribution, so that all is nearly transparent; none for no such check
    splits : whether slabs are cut at brick faces, so that pictures are compared within one brick size
    announce : called with the number of jobs, and after the first with the time expected
    compare_samples : whether pictures with equal bricks must have equal numbers of samples, as the ownership check
        always requires
    """
    transparent = [*overrides, *faint, "quality.early_termination=0"]
    kinds = {(c.ranks, c.brick, c.mode, c.tiling, c.distribution): c for c in configurations[::-1]}
    owners = list(kinds.values())[::-1] if faint else []
    jobs = [("picture", c, overrides) for c in configurations] + [("ownership", c, transparent) for c in owners]
    results: list[Result] = []
    steps = [f"{check}: {configuration}" for check, configuration, _ in jobs]
    # Ranks that share a core run one after the other.
    costs = [max(1.0, configuration.ranks / len(granted_cores())) for _, configuration, _ in jobs]
    announce(f"{len(jobs)} renders, on {', '.join(map(str, sorted({c.ranks for _, c, _ in jobs})))} ranks")
    began = perf_counter()
    with tempfile.TemporaryDirectory(prefix="clusterviz-verify-") as folder, show_progress(steps, costs) as progress:
        firsts: dict[tuple[str, int], Pixels] = {}
        counts: dict[tuple[str, int], int] = {}
        for step, (check, configuration, settings) in zip(steps, jobs, strict=True):
            progress(step)
            picture, samples = _render(scene, settings, configuration, Path(folder))
            if step == steps[0]:
                announce(f"about {(perf_counter() - began) / costs[0] * sum(costs[1:]):.0f} s to go")
            # Slabs that are cut at brick faces give another picture for each brick size.
            first = firsts.setdefault((check, configuration.brick if splits else 0), picture)
            # The bricks skipped as transparent or invalid depend on the brick size.
            count = counts.setdefault((check, configuration.brick), samples)
            if check == "picture":
                count = count if compare_samples else samples
                results.append(_judge_picture(configuration, picture, first, tolerance, samples, count))
            else:
                results.append(_judge_ownership(configuration, picture, first, samples, count))
    return results


def _render(scene: str, overrides: list[str], configuration: Configuration, folder: Path) -> tuple[Pixels, int]:
    """Render one configuration; return the picture, with depths if it has any, and the samples of all ranks."""
    has_layers = bool(open_scene(scene, overrides).image.layers)
    picture, stats = folder / ("picture.npz" if has_layers else "picture.npy"), folder / "statistics.json"
    settings = [
        *overrides,
        f"cluster.compositing={configuration.algorithm}",
        f"cluster.transport={configuration.transport}",
        f"cluster.brick={configuration.brick}",
        f"cluster.mode={configuration.mode}",
        f"cluster.tiling={configuration.tiling}",
        f"cluster.distribution={configuration.distribution if configuration.mode == 'sort-last' else 'auto'}",
        "cluster.groups=null",
    ]
    defines = [word for setting in settings for word in ("-D", setting)]
    several_nodes = configuration.transport == "hierarchical"
    environment = {RANKS_PER_NODE_VARIABLE: str(SIMULATED_RANKS_PER_NODE)} if several_nodes else {}
    arguments = ["render", scene, "-o", str(picture), "--stats", str(stats), *defines]
    run_job(configuration.ranks, arguments, environment=environment)
    frame = json_text.loads(stats.read_text())["frames"][0]
    pixels = _with_depth(picture) if has_layers else read_image(picture)
    return pixels, sum(r["samples"] - r["samples_estimate"] for r in frame["per_rank"])


def _with_depth(picture: Path) -> Pixels:
    """Return the colours of a picture and, if it has that layer, depth as a share of the largest, 0 where infinite."""
    with np.load(picture) as arrays:
        depth = arrays.get("depth", np.zeros(arrays["rgba"].shape[:2], np.float32))
        depth = np.where(np.isfinite(depth), depth, np.float32(0))
        return np.dstack([arrays["rgba"], depth / max(float(depth.max()), 1e-30)])


def _judge_picture(
    configuration: Configuration, picture: Pixels, first: Pixels, tolerance: float, samples: int, expected: int
) -> Result:
    difference = compare(picture, first, tolerance)
    found = (difference.max, difference.rms, tolerance, difference.first_wrong_pixel)
    return Result("picture", configuration, *found, samples, _problem(difference, samples, expected))


def _judge_ownership(
    configuration: Configuration, picture: Pixels, first: Pixels, samples: int, expected: int
) -> Result:
    """Compare nearly transparent pictures relative to their brightest pixel, and numbers of samples."""
    scale = float(np.abs(first).max()) or 1.0
    difference = compare(picture / scale, first / scale, FAINT_TOLERANCE)
    found = (difference.max, difference.rms, FAINT_TOLERANCE, difference.first_wrong_pixel)
    return Result("ownership", configuration, *found, samples, _problem(difference, samples, expected))


def _problem(difference: Difference, samples: int, expected: int) -> str:
    problems = [str(difference)] if difference.count else []
    if samples != expected:
        problems.append(f"{samples} samples instead of {expected}")
    return "; ".join(problems)


def _print_json(results: list[Result], comparison: ReferenceComparison | None) -> None:
    report = {
        "agree": not any(result.problem for result in results),
        "results": [asdict(result) for result in results],
        "reference": asdict(comparison) if comparison else None,
    }
    print(json_text.dumps(report, indent=2))


def _print_table(results: list[Result], comparison: ReferenceComparison | None) -> None:
    rows = [("check", "ranks", "compositing", "brick", "max", "rms", "samples", "")]
    for result in results:
        where = "ok" if not result.problem else "WRONG"
        if result.first_wrong_pixel:
            where += " at row {}, column {}".format(*result.first_wrong_pixel)
        c = result.configuration
        numbers = (f"{result.max:.2e}", f"{result.rms:.2e}", f"{result.samples:,}")
        rows.append((result.check, str(c.ranks), c.method, str(c.brick), *numbers, where))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(f"{text:{width}}" for text, width in zip(row, widths, strict=True)).rstrip())
    if comparison:
        print(f"\n{comparison}")
