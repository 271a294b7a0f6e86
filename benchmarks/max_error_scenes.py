"""How often `quality.max_error` is held.

    python benchmarks/max_error_scenes.py [--scenes N] [--first K] [--size S] [--hard] [--json F]

Random scenes, each from its number alone: data of seven kinds in 8 and 16 bits and float32, one volume or two, smooth
opacities, ramps, peaks of 1 to 4 % of the range and jumps, some lit, some cut, seen from anywhere, with bounds from
1/255 to 0.02. With `--hard` they are small and adversarial: crops of a head's CT, specks, rods, balls, shells, noise,
peaks of 0.5 to 2 % of the range, flanks just below what counts as a jump, opacities to 0.99, every blend mode that
takes a bound, and bounds from 1/512 to 0.05; a scene takes about a second.

The truth is drawn with pre-integrated slabs at steps halved down to 1/512 of a voxel, until a halving changes no pixel
by more than a twentieth of the bound, or by a fourth of what the error is away from the bound: what it changed last is
how well it is known. At the end stands how many bounds were held, refused, and broken silently.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from measuring import Row, options, sample, show, timed, write
from numpy.typing import NDArray

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.field import open_field
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import SceneError
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import Scene
from clusterviz.scene.overrides import with_settings

BOUNDS = (0.02, 4 / 255, 2 / 255, 1 / 255)
KINDS = ("waves", "blobs", "noise", "smoothed noise", "labels", "marschner-lobb", "hydrogen")
FUNCTIONS = ("smooth", "ramp", "peaks", "peaks", "jumps", "colour jumps")
KNOWN, FINEST = 1 / 20, 1 / 512
HARD_KINDS = ("head", "head", "shells", "specks", "rods", "ball", "noise", "smoothed noise")
HARD_FUNCTIONS = ("narrow peaks", "narrow peaks", "below steep", "ramp", "boxes")


@dataclass(frozen=True)
class Tried:
    """A scene, what was promised and what was kept; `seconds` are of CPU time, pilots included, and without."""

    number: int
    kind: str
    dtype: str
    function: str
    volumes: int
    lit: bool
    clipped: bool
    bound: float
    expected: float
    error: float
    known_to: float
    refused: bool
    step: float
    classification: str
    pilot_share: float
    seconds: float

    @property
    def broken(self) -> bool:
        """Whether the bound was broken for certain."""
        return not self.refused and self.error > self.bound + self.known_to


def main() -> None:
    hard = {"action": "store_true", "help": "small adversarial scenes; --size is not used"}
    asked = options(__doc__, scenes=200, first=0, size=128, hard=hard)
    found = list[Tried]()

    def rows() -> Iterator[Row]:
        for number in range(asked.first, asked.first + asked.scenes):
            found.append(one := tried(number, None if asked.hard else asked.size))
            yield asdict(one) | {"verdict": "BROKEN" if one.broken else "refused" if one.refused else "held"}

    head = "number | kind | type | opacity | volumes | lit | clipped | bound | expected | error | known to | step | "
    cells = "{number} | {kind} | {dtype} | {function} | {volumes} | {lit} | {clipped} | {bound:.4f} | {expected:.4f} | "
    cells += "{error:.5f} | {known_to:.0e} | {step:.4f} | {classification} | {pilot_share:.2f} | {verdict}"
    write(asked, rows=show(head + "classification | pilots | verdict", cells, rows()))
    print("\n".join(summary(found)))


def summary(found: list[Tried]) -> list[str]:
    promised = [one for one in found if not one.refused]
    broken = [one for one in promised if one.broken]
    ratios = np.sort([one.error / one.bound for one in promised] or [0.0])[::-1]
    return [
        f"{len(found)} scenes: {len(promised) - len(broken)} held, {len(found) - len(promised)} refused; "
        f"{len(broken)} broken silently",
        f"largest errors of those that were promised, of their bounds: {', '.join(f'{r:.2f}' for r in ratios[:5])}; "
        f"median {np.median(ratios):.2f}",
        f"pilots took {np.median([one.pilot_share for one in found]):.2f} of a frame's samples (median); frames and "
        f"pilots {sum(one.seconds for one in found):.0f} s of processor time",
    ]


def tried(number: int, size: int | None) -> Tried:
    """Draw one scene with its bound, and its truth; no size: an adversarial scene."""
    scene, sources, told = hard_scene(number) if size is None else usual_scene(number, size)
    bound = scene.quality.max_error or 0.0
    run = timed(lambda: frame_or_refusal(scene, sources))
    drawn = run.value
    if drawn is None:
        return Tried(*told, 0.0, 0.0, 0.0, True, 1.0, "none", 0.0, run.cpu)
    accuracy, samples = drawn.statistics.accuracy, sum(rank.samples for rank in drawn.statistics.per_rank)
    error, known_to = error_of(drawn, sources, bound)
    return Tried(
        *told,
        *(accuracy.error, error, known_to, False),
        *(accuracy.step, accuracy.classification, accuracy.pilot_samples / max(1, samples), run.cpu),
    )


def usual_scene(number: int, size: int) -> tuple[Scene, list[ArraySource], tuple[Any, ...]]:
    """Scene, volumes, and what the line says of them."""
    rng = np.random.default_rng([19, number])
    kind, function = str(rng.choice(KINDS)), str(rng.choice(FUNCTIONS))
    dtype, bound = str(rng.choice(["uint8", "uint16", "float32"])), float(rng.choice(BOUNDS))
    volumes, lit = (2 if rng.random() < 1 / 6 else 1), bool(rng.random() < 1 / 6)
    sources = [source_of(rng, kind, dtype, k) for k in range(volumes)]
    entries = [look_of(rng, function, source, lit) for source in sources]
    away, clipped = rng.normal(size=3), bool(rng.random() < 1 / 6)
    planes = [[centre_of(sources).tolist(), (-away).tolist()]] if clipped else []
    camera = camera_of(away / np.linalg.norm(away), sources, rng)
    scene = scene_of(entries, (size, size), camera, bound, planes)
    return scene, sources, (number, kind, dtype, function, volumes, lit, clipped, bound)


def hard_scene(number: int) -> tuple[Scene, list[ArraySource], tuple[Any, ...]]:
    """An adversarial one."""
    rng = np.random.default_rng([34, number])
    kind, function = str(rng.choice(HARD_KINDS)), str(rng.choice(HARD_FUNCTIONS))
    dtype, bound = str(rng.choice(["uint8", "uint16", "float32"])), float(np.exp(rng.uniform(*np.log([1 / 512, 0.05]))))
    shape, clipped = tuple(int(n) for n in rng.integers(10, 19, 3)), bool(rng.random() < 1 / 10)
    source = array_of(rng, hard_values(rng, kind, shape), dtype, kind)
    entry = look_of(rng, function, source, bool(rng.random() < 1 / 8))
    entry["opacity_unit_distance"] = float(np.exp(rng.uniform(*np.log([0.3, 3.0]))))
    entry["blending"] = str(rng.choice(["composite"] * 8 + ["maximum", "minimum", "average", "additive"]))
    entry["shade"] = entry["shade"] and entry["blending"] == "composite"
    away = np.eye(3)[rng.integers(3)] if rng.random() < 1 / 6 else rng.normal(size=3)
    camera = camera_of(away / np.linalg.norm(away), [source], rng)
    if rng.random() < 1 / 3:
        camera["parallel_scale"] = float(np.linalg.norm(np.ptp(source.grid.corners, axis=0))) / 2
    size = tuple(int(n) for n in rng.integers(64, 161, 2))
    planes = [[centre_of([source]).tolist(), (-away).tolist()]] if clipped else []
    scene = scene_of([entry], size, camera, bound, planes)
    return scene, [source], (number, kind, dtype, function, 1, entry["shade"], clipped, bound)


def scene_of(
    entries: list[dict[str, Any]], size: tuple[int, ...], camera: dict[str, Any], bound: float, planes: list[Any]
) -> Scene:
    """The scene of these parts."""
    image, quality = {"size": size, "background": "black"}, {"max_error": bound}
    parts = {"volumes": entries, "image": image, "camera": camera, "quality": quality, "clip": {"planes": planes}}
    return Scene.model_validate(parts)


def error_of(drawn: Any, sources: list[ArraySource], bound: float) -> tuple[float, float]:
    """A picture's largest difference from the converged one, and what the last halving of the step changed."""
    fine = {"early_termination": 0.0, "filter": "exact", "pixel": "float32", "classification": "pre-integrated"}
    step = 1 / 32
    before = frame_of(with_settings(drawn.scene, fine | {"step": step}), sources).image
    while True:
        step /= 2
        found = frame_of(with_settings(drawn.scene, fine | {"step": step}), sources).image
        change, error = float(np.abs(found - before).max()), float(np.abs(drawn.image - found).max())
        if change <= max(KNOWN * bound, abs(error - bound) / 4) or step <= FINEST:
            return error, change
        before = found


def frame_of(scene: Scene, sources: list[ArraySource]) -> Any:
    with FrameLoop(scene, LoopbackChannel(), sources, Options(device="cpu", overlap=False), several=False) as loop:
        return loop.frame()


def frame_or_refusal(scene: Scene, sources: list[ArraySource]) -> Any:
    """One frame; None where its bound is out of reach."""
    try:
        return frame_of(scene, sources)
    except SceneError as refusal:
        if "out of reach" not in str(refusal):
            raise
        return None


def centre_of(sources: list[ArraySource]) -> NDArray[Any]:
    centre: NDArray[Any] = np.concatenate([source.grid.corners for source in sources]).mean(axis=0)
    return centre


def camera_of(away: NDArray[Any], sources: list[ArraySource], rng: np.random.Generator) -> dict[str, Any]:
    """From any direction, the volumes filling the picture."""
    corners, centre = np.concatenate([source.grid.corners for source in sources]), centre_of(sources)
    radius = float(np.linalg.norm(np.ptp(corners, axis=0))) / 2
    view_up = np.cross(away, rng.normal(size=3))
    where = {"focal_point": centre.tolist(), "view_up": view_up.tolist(), "view_angle": 30.0}
    return where | {"position": (centre + away * radius * float(rng.uniform(2.5, 4.0))).tolist()}


def look_of(rng: np.random.Generator, function: str, source: ArraySource, lit: bool) -> dict[str, Any]:
    """A volume of the scene: colours, and opacity of one kind over its range."""
    values = source.read((0, 0, 0), source.grid.shape_zyx)
    low, high = float(values.min()), float(values.max())
    points = np.array(opacity_of(rng, function))
    look = {"path": source.name, "clim": [low, high], "cmap": str(rng.choice(["viridis", "bone", "coolwarm"]))}
    if function == "colour jumps":
        edges = np.repeat(np.sort(rng.uniform(0.1, 0.9, 3)), 2)
        places = low + (high - low) * np.concatenate([[0.0], edges, [1.0]])
        look["cmap"] = np.column_stack([places, np.repeat(rng.random((4, 3)), 2, axis=0)]).tolist()
    opacity = np.column_stack([low + points[:, 0] * (high - low), points[:, 1]]).tolist()
    return look | {"opacity": opacity, "opacity_unit_distance": float(rng.choice([0.5, 1.0, 2.0])), "shade": lit}


def opacity_of(rng: np.random.Generator, function: str) -> list[tuple[float, float]]:
    """Points of (share of the range, opacity)."""
    height = rng.uniform(0.2, 0.95)
    if function in ("narrow peaks", "below steep"):
        narrow, count = function == "narrow peaks", int(rng.integers(1, 4))
        rows = [(0.0, 0.0)]
        for place in np.sort(rng.permutation(8)[:count] if narrow else rng.permutation(3)[:count] * 3) / 9 + 0.14:
            top = rng.uniform(0.5, 0.99)
            half = float(rng.uniform(0.0025, 0.01)) if narrow else top / float(rng.uniform(7.0, 7.99))
            rows += [(max(place - half, 1e-6), 0.0), (place, top), (place + half, 0.0)]
        return [*rows, (1.0, 0.0)]
    if function == "boxes":
        low, high = np.sort(rng.uniform(0.05, 0.95, 2))
        return [(0.0, 0.0), (low, 0.0), (low, top := rng.uniform(0.5, 0.99)), (high, top), (high, 0.0), (1.0, 0.0)]
    if function == "peaks":
        rows, count, half = [(0.0, 0.0)], int(rng.integers(1, 4)), float(rng.choice([0.01, 0.02, 0.04])) / 2
        for place in np.sort(rng.permutation(8)[:count]) / 9 + 0.1:
            rows += [(place - half, 0.0), (place, rng.uniform(0.2, 0.95)), (place + half, 0.0)]
        return [*rows, (1.0, 0.0)]
    if function == "jumps":
        rows, before = [(0.0, 0.0)], 0.0
        for place in np.sort(rng.uniform(0.2, 0.9, int(rng.integers(1, 4)))):
            after = float(rng.choice([0.0, 0.05, 0.3, 0.9]))
            rows += [(place, before), (place, after)]
            before = after
        return [*rows, (1.0, before)]
    if function == "ramp":
        begin, end = np.sort(rng.uniform(0.0, 1.0, 2))
        return [(0.0, 0.0), (begin, 0.0), (min(1.0, max(end, begin + 0.1)), height)]
    places, middle, width = np.linspace(0, 1, 64), rng.uniform(0.3, 0.8), rng.uniform(0.1, 0.3)
    return list(zip(places, height * np.exp(-(((places - middle) / width) ** 2)), strict=True))


def source_of(rng: np.random.Generator, kind: str, dtype: str, place: int) -> ArraySource:
    """Data of a kind, with values over all of the type's range; a second volume lies beside the first."""
    shape = tuple(int(n) for n in rng.integers(14, 41, 3))
    return array_of(rng, values_of(rng, kind, shape), dtype, f"{kind}-{place}", place)


def array_of(rng: np.random.Generator, values: NDArray[Any], dtype: str, name: str, place: int = 0) -> ArraySource:
    """A volume of floats of any range."""
    values = (values - values.min()) / max(float(np.ptp(values)), 1e-12)
    if dtype != "float32":
        values = np.round(values * np.iinfo(dtype).max)
    spacing = tuple(float(s) for s in rng.choice([1.0, 1.0, 0.7, 1.5], 3))
    origin = tuple(float(o) for o in place * rng.uniform(-8, 8, 3))
    return ArraySource(values.astype(dtype), Grid(values.shape, spacing, origin), name)


def hard_values(rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Any floats, (z, y, x)."""
    if kind in KINDS:
        return values_of(rng, kind, shape)
    if kind == "head":
        head = open_source(sample(name="cranium"), None)
        for _ in range(20):
            at = tuple(int(rng.integers(0, n - m)) for n, m in zip(head.grid.shape_zyx, shape, strict=True))
            found = head.read(at, tuple(np.add(at, shape).tolist())).astype(np.float64)
            if np.ptp(found) > 0:
                return found
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    a, b, c = rng.uniform(-0.4, 0.4, 3)
    distance = np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2)
    if kind == "specks":
        return np.where(rng.random(shape) < 0.01, rng.random(shape), 0.05 * rng.random(shape))
    if kind == "rods":
        return np.exp(-((np.hypot(x - a, y - b + 0.3 * z) / rng.uniform(0.05, 0.2)) ** 2)) + 0.1 * distance
    if kind == "ball":
        return np.clip((rng.uniform(0.3, 0.8) - distance) * rng.uniform(1, 12), -1, 1)
    edges = np.sort(rng.uniform(0.2, 1.2, 3))  # skin, bone and what is inside, with noise as of a scanner
    return np.array([0.5, 1.0, 0.3, 0.0])[np.digitize(distance, edges)] + rng.normal(0, 0.02, shape)


def values_of(rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Any floats, (z, y, x)."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    if kind == "waves":
        found = np.zeros(shape)
        for _ in range(4):
            a, b, c = rng.uniform(-8, 8, 3)
            found += np.sin(a * x + b * y + c * z + rng.uniform(0, 6))
        return found
    if kind == "blobs":
        found = np.zeros(shape)
        for _ in range(6):
            p, width = rng.uniform(-0.7, 0.7, 3), rng.uniform(0.1, 0.5)
            found += np.exp(-((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2) / width**2)
        return found
    if kind in ("noise", "smoothed noise", "labels"):
        found = rng.random(shape)
        for _ in range({"noise": 0, "smoothed noise": 3, "labels": 12}[kind]):
            for axis in range(3):
                found = (np.roll(found, 1, axis) + 2 * found + np.roll(found, -1, axis)) / 4
        return np.digitize(found, np.quantile(found, [0.5, 0.7, 0.9])) if kind == "labels" else found
    side = max(shape)
    cube = open_field(f"field:{kind}:{side}")
    found = cube.read((0, 0, 0), (side, side, side)).astype(np.float64)
    return found[: shape[0], : shape[1], : shape[2]]


if __name__ == "__main__":
    main()
