"""Bad input to every command: one line that says what, where, found and allowed; status 2; nothing made or changed."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FIELD = "field:marschner-lobb:16"
ONE = f"volumes: [{{path: '{FIELD}'}}]"
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(44)
COMPOSITE = "bench composite --images images --size 23x17 --frames 1"
SIMULATE = "simulate --ranks 12 --size 64x48"
ORBIT = "--orbit 360 --frames 3"

# What is on the disk before; None is a folder.
FILES: dict[str, bytes | None] = {
    "file": b"",
    "folder.png": None,
    "images": None,
    **{f"images/img_{rank}.rgba": b"\x09" * (23 * 17 * 4) for rank in range(3)},
    "texts": None,
    "texts/other.txt": b"",
    "short": None,
    "short/img_0.rgba": b"1234",
    "broken": None,
    "broken/a.npy": b"1234",
    "flat": None,
    "nothing.yaml": b"volumes: []",
}
COMMANDS = [
    *(
        (command, "not a regular file; found a FIFO; allowed a file on a disk")
        for command in (
            *(
                f"render fifo.{extension} -o new.png"
                for extension in ("npy", "vtk", "h5", "nii.gz", "tif", "csv", "yaml")
            ),
            *(f"render fifo.{extension} -o new.png" for extension in ("ply", "vtu", "gltf", "pvd", "dcm", "json")),
            *(f"render {FIELD} -o new.png -D volumes.0.{key}" for key in ("path=fifo.npy", "shader=fifo.glsl")),
            f"render {FIELD} -o new.png -D volumes.0.cmap=fifo.json",
            f"render {FIELD} -o new.png -D volumes.0.transfer_2d.path=fifo.npy",
            f"animate {FIELD} -o frame_%d.png --path fifo.yaml",
            "info fifo.npy",
            "scene fifo.png",
            "replay fifo.png",
            "illuminate fifo.npz -o new.png",
            f"{SIMULATE} --algorithm tree --network fifo.json",
        )
    ),
    (f"info field:ramp:{10**12}", "impossible size; found 1000000000000; allowed one whole number, 1 to 1048576"),
    (f"render field:ramp:{10**6} -o new.png", "too large a volume; found 1000000 × 1000000 × 1000000 samples; allowed"),
    (f"render {FIELD} -o new.png --size 65000x65000", "image.size: too large a picture; found 65000 × 65000"),
    (f"render {FIELD} -o {'n' * 300}.png", "cannot be written; found a name of 304 bytes; allowed at most 255"),
    (f"info {'n' * 300}.npy", ".npy: file name too long"),
    ("info none.npy", "none.npy: no such file"),
    ("store none.npy new.zarr", "none.npy: no such file"),
    (f"store {FIELD} new.tif", "not a name of a store; found new.tif; allowed OUT.ome.zarr"),
    (f"store {FIELD} none/new.zarr", "the folder none is missing"),
    (f"store {FIELD} new.zarr --as slices", "not what files can be; found slices; allowed time, channels"),
    (f"store {FIELD} field:gaussian:9 new.zarr", "volumes of different shape or type"),
    (f"store {FIELD} new.zarr --codec zip", "no such codec; found zip; allowed wavelet, zstd"),
    (f"store {FIELD} new.zarr --codec zstd --error 1", "impossible error; found 1.0; allowed 0; more with wavelets"),
    ("view none.npy --port 0", "none.npy: no such file"),
    (f"view {FIELD} --host 192.0.2.1", "192.0.2.1:8787: cannot listen: cannot assign requested address; allowed"),
    ("samples mni", "no such sample; found mni; allowed mni152"),
    ("cmaps --kind warm", "--kind: unknown kind; found warm; allowed cyclic, diverging, misc"),
    ("cmaps veridis", "cmaps: unknown colour map; found veridis; allowed a name that `clusterviz cmaps` lists, for "),
    (f"animate none.npy -o none/frame_%d.png {ORBIT}", "none is missing"),
    (f"animate none.npy -o none/a.mp4 {ORBIT}", "none is missing"),
    (f"animate none.npy -o frame.png {ORBIT}", "not a name for frames; found frame.png"),
    (f"animate none.npy -o frame_%d_%d.png {ORBIT}", "not a name for frames"),
    (f"animate none.npy -o frame_%s%d.png {ORBIT}", "not a name for frames"),
    (f"animate none.npy -o frame_%d.jpg {ORBIT}", "not a name for frames"),
    (f"animate none.npy -o frame_%d.png {ORBIT} --trace none/t.json", "none is missing"),
    ("animate none.npy -o frame_%d.png --frames 3", "nothing moves; allowed --orbit DEGREES"),
    ("animate none.npy -o frame_%d.png --orbit 90", "--frames: missing"),
    ("animate none.npy -o frame_%d.png --path none.yaml", "none.yaml: cannot be read"),
    ("bench raycast nothing.yaml", "nothing to draw"),
    (f"{COMPOSITE} --algorithm magic", "unknown compositing algorithm; found magic"),
    (f"{COMPOSITE} --codec magic", "found magic"),
    (f"{COMPOSITE} --transport magic", "unknown transport; found magic; allowed messages, shared, hierarchical, auto"),
    (f"{COMPOSITE} --size 5", "--size: not a size"),
    (f"{COMPOSITE} --size 24x17", "img_0.rgba: not the size of the picture; found 1564 bytes; allowed 1632"),
    (f"{COMPOSITE} --images nowhere", "nowhere/img_0.rgba: cannot be read"),
    (f"{COMPOSITE} --out nowhere/o.rgba", "nowhere is missing"),
    ("bench codec --images texts --size 30x20", "no pictures"),
    ("bench codec --images short --size 30x20", "not the size of the picture"),
    ("bench codec --images broken --size 30x20", "cannot be read"),
    ("bench codec --images flat", "not a picture"),
    (f"{SIMULATE} --algorithm swap", "unknown compositing algorithm"),
    (f"{SIMULATE} --algorithm tree --pixel float64", "--pixel"),
    (f"{SIMULATE} --algorithm tree --network token-ring", "no such network file"),
    (f"{SIMULATE} --algorithm radix-k --factors 3,x", "--factors"),
    (f"{SIMULATE} --algorithm radix-k --factors 5", "radix-k"),
    (f"{SIMULATE} --algorithm tree --draw s.pdf", "s.pdf"),
    (f"{SIMULATE} --algorithm tree --footprints balls", "unknown footprints"),
    (f"scale {FIELD} -o out --ranks 1,two", "--ranks: not a count; found two"),
    (f"scale {FIELD} -o out --ranks 0", "--ranks: not a count"),
    (f"scale {FIELD} -o out --size 0x3", "--size: too small"),
    (f"scale {FIELD} -o out --network carrier-pigeon", "no such network file"),
    (f"scale {FIELD} -o out -D volumes=[]", "nothing to measure"),
    (f"scale {FIELD} -o images", "would overwrite other files"),
    (f"tradeoff {FIELD} -o out --knobs speed", "--knobs: unknown knob; found speed"),
    (f"tradeoff {FIELD} -o out --size 0x3", "--size: too small"),
    (f"tradeoff {FIELD} -o out -D volumes=[]", "nothing to trade"),
    (f"tradeoff {FIELD} -o images", "would overwrite other files"),
    (f"profile {FIELD} -o out --by vulkan", "--by: nothing that draws; found vulkan; allowed cpu or gl"),
    ("profile none.npy -o out", "no such file"),
    (f"profile {FIELD} -o out -D volumes=[]", "nothing to draw"),
    (f"profile {FIELD} -o images", "would overwrite other files"),
    (f"profile {FIELD} -o file", "cannot be a folder"),
    (f"profile {FIELD} -o out --size 9x9 --by cpu -D volumes.0.opacity=[[0,0],[1,0]]", "nothing to draw"),
    (f"animate {FIELD} -o frame_%d.png --time", "--time: no volume has several time steps"),
    (
        f"render {FIELD} -o a.png -D volumes.0.time=1.5",
        "not a time step; found 1.5; allowed its number, a whole number",
    ),
    (f"render {FIELD} -o a.png -D volumes.0.time=all", "a picture shows one time step; found all; allowed time: its"),
    (f"complexity {FIELD} -o out", "meshes, lines, points: nothing to count; allowed a scene with one of them"),
    (f"complexity {FIELD} -o out --frames 3", "--frames: nothing moves; found 3; allowed --orbit DEGREES"),
    (f"complexity {FIELD} -o out --orbit 90", "--frames: missing"),
    (f"kbuffer {FIELD} -o out", "grids: no k-buffer draws it; found 0; allowed a scene of one unstructured grid"),
    (f"verify {FIELD} --ranks 1,x", "--ranks: not a count; found x"),
    (f"verify {FIELD} --ranks 0", "--ranks: not a count; found 0"),
    (f"verify {FIELD} --algorithms tree,magic", "--algorithms: unknown name; found magic"),
    (f"verify {FIELD} --bricks 1", "--bricks: not a count; found 1"),
    # Outputs are checked before the data is read.
    ("render none.npy -o none/a.png", "none is missing; allowed a folder that is there"),
    ("render none.npy -o file/a.png", "file is not a folder; allowed a file in a folder"),
    ("render none.npy -o file/none/a.png", "none is not a folder; allowed a file in a folder"),
    ("render none.npy -o folder.png", "found a folder"),
    ("render none.npy -o a.bmp", "unknown extension; found .bmp; allowed .png, .npy, .exr"),
    ("render none.npy -o a", "unknown extension; found none"),
    (f"render {FIELD} -o new.png --layers depth", "holds no layers; found .png; allowed .exr, .npz"),
    (f"render {FIELD} -o new.exr --layers depth,colour", "--layers: unknown name; found colour"),
    (f"animate {FIELD} --orbit 9 --frames 2 -o new.mp4 --layers all", "pictures with a field for their number"),
    ("render none.npy -o new.png --stats none/s.json", "none is missing; allowed a folder that is there"),
    ("render none.npy -o new.png --stats folder.png", "found a folder"),
]
OPTIONS = [
    ("-D image.layers=[depth] -D blending=maximum", 'image.layers: not with blending: maximum; found ["depth"]'),
    ("-D image.layers=[depth] -D quality.borders=split", "image.layers: not with borders: split"),
    ("-D detail=coarse", 'volumes[0].detail: not a detail; found "coarse"; allowed full, {level: n}, {error: e}'),
    ('-D detail={"level":1,"error":0.1}', "volumes[0].detail: not one of level, error, memory and seconds"),
    ('-D detail={"memory":"512Mb"}', 'volumes[0].detail.memory: not a size; found "512Mb"; allowed bytes, or a number'),
    ('-D detail={"level":-1}', "volumes[0].detail.level: too small; found -1"),
    ('-D detail={"level":1}', "volumes[0].detail: the volume has no levels"),
    ('-D detail={"level":1} -D blending=maximum', "volumes[0].blending: not with volumes[].detail: their values"),
    ("-D quality.stepp=1", "unknown key, did you mean step?"),
    ("-D quality.step", "not a key with a value"),
    ("-D cluster.compositing=magic", "not one of the choices"),
    ("--size 800", "--size: not a size; found 800; allowed WIDTHxHEIGHT"),
    ("--size 0x5", "--size: too small; found 0x5; allowed 1 to 65536 pixels a side"),
    ("--size 100000x100000", "--size: too large; found 100000x100000; allowed 1 to 65536 pixels a side"),
    ("-D clim=5", "volumes[0].clim: not a list; found 5; allowed a list, such as [20, 200]"),
    ("-D clim=[5]", "volumes[0].clim: too few values; found [5]; allowed a list, such as [20, 200]"),
    ("-D clim=[1,2,3]", "clim: too many values; found [1, 2, 3]; allowed at most 2 values, such as [20, 200]"),
    ("-D opacity=[1]", "volumes[0].opacity[0]: not a list; found 1; allowed a list, such as [20, 0]"),
    ("-D opacity=[[1]]", "opacity[0]: too few values; found [1]; allowed a list, such as [20, 0]"),
    ("-D cmap=[[1]]", "cmap[0]: too few values; found [1]; allowed a list, such as [20, 0, 0, 0]"),
    ("-D gradient_opacity=3", "not a list; found 3; allowed a list, such as [[0, 0], [10, 1]]"),
    ("-D isosurfaces=3", "not a list; found 3; allowed a list, such as [[90, 0.5], 120]"),
    ("-D size=4", "image.size: not a list; found 4; allowed a list, such as [800, 600]"),
    ("-D background=[1]", "too few values; found [1]; allowed a list, such as [0.1, 0.2, 0.4]"),
    ("-D position=4", "camera.position: not a list; found 4; allowed a list, such as [0, 0, 1]"),
    ("-D view_up=[0,0,0]", "the zero vector has no direction; found [0.0, 0.0, 0.0]; allowed a direction, such as"),
    ("-D box=[1]", "clip.box: too few values; found [1]; allowed a list, such as [0, 10, 0, 10, 0, 5]"),
    ("-D planes=[1]", "clip.planes[0]: not a list; found 1; allowed a list, such as [[0, 0, 0], [1, 0, 0]]"),
    ("-D lights=3", 'lights: not a list; found 3; allowed a list, such as [{"position": [1, 1, 1]}]'),
    ("--device 99", "no such EGL device; found 99; allowed 0"),
    ("--device gpu", "--device: not a device; found gpu; allowed cpu"),
]
SCENES = [
    (f"volumes: [{{path: '{FIELD}', opacty: 1}}]", "unknown key, did you mean opacity?"),
    (f"{ONE}\nstep: 2", "unknown key, did you mean quality.step?"),
    ("volumes: [{}]", 'volumes[0].path: missing; allowed a value, such as "head.nii.gz"'),
    ("volumes: head.npy", 'volumes: not a list; found "head.npy"; allowed a list, such as [{"path": "head.nii.gz"}]'),
    (f"{ONE}\nquality: {{step: big}}", "quality.step: not a number"),
    (f"{ONE}\nquality: {{step: 0}}", "quality.step: too small; found 0"),
    (f"{ONE[:-1]}, {{path: a, blending: average}}]", "volumes[1].blending: not for several volumes"),
    ("camera: {position: [1, 1, 1], focal_point: [1, 1, 1]}", "camera"),
    ("camera: {position: [0, 0, 5], focal_point: [0, 0, 0], view_up: [0, 0, 1]}", "view_up"),
    ("volumes: [", "not YAML"),
    ("", "the scene file is empty"),
    ("volumes: [{path: none.npy}]", "no such file"),
]
DATA: list[tuple[str, bytes, str]] = [
    ("empty.npy", b"", "empty"),
    ("wrong.nii", b"not a header " * 40, "found text"),
    ("unknown.abc", b"1 2 3", "unknown extension; found .abc, text; allowed .npy, "),
    ("picture.abc", PNG, "unknown extension; found .abc, a PNG picture; allowed .npy, "),
    ("a.npy", PNG, "a.npy: wrong magic: not what its name says; found a PNG picture; allowed a NumPy array (.npy)"),
    ("a.nrrd", PNG, "found a PNG picture; allowed NRRD"),
    ("a.nii", PNG, "found a PNG picture; allowed NIfTI-1 or NIfTI-2"),
    ("a.nii.gz", PNG, "found a PNG picture; allowed packed by gzip"),
    ("a.tif", PNG, "found a PNG picture; allowed TIFF"),
    ("a.vti", PNG, "found a PNG picture; allowed VTK's XML"),
    ("a.mrc", PNG, "found 60 bytes, a PNG picture; allowed 1024 and more"),
    ("a.h5", b"PK\x03\x04" + bytes(2000), "found a ZIP archive (.zip, .npz, .docx); allowed HDF5"),
    ("b.mrc", bytes(2000), "found zeros; at byte 208 b"),
    ("a.tiff", bytes(344) + b"n+1\0" + bytes(8), "found NIfTI; allowed TIFF"),
    ("b.nrrd", bytes(128) + b"DICM" + bytes(300), "found DICOM; allowed NRRD"),
    ("c.nrrd", bytes(range(128, 192)) * 9, "found bytes of an unknown kind; allowed NRRD"),
    ("a.raw", b"1234", "a.raw.yaml with the keys shape, dtype, byte_order, "),
]
CASES = [
    *((arguments, {}, said) for arguments, said in COMMANDS),
    *((f"render {FIELD} -o new.png {options}", {}, said) for options, said in OPTIONS),
    ("render missing.nrrd -o new.png", {}, "no such file"),
    *(("render scene.yaml -o new.png", {"scene.yaml": text.encode()}, said) for text, said in SCENES),
    *((f"render {name} -o new.png", {name: content}, said) for name, content, said in DATA),
]


@pytest.mark.cover
@pytest.mark.parametrize(("arguments", "files", "said"), CASES)
def test_bad_input(
    arguments: str,
    files: dict[str, bytes],
    said: str,
    cli: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in (FILES | files).items():
        Path(name).write_bytes(content) if content is not None else Path(name).mkdir()
    np.save("flat/a.npy", np.zeros((4, 4)))
    for name in re.findall(r"fifo\.[a-z0-9.]+", arguments):
        os.mkfifo(name)
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    outcome = cli(*arguments.split())
    assert (outcome.status, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome.err
    assert outcome.err.startswith("clusterviz: error: ")
    assert said in outcome.err
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(
    ("command", "does"),
    [
        *((name, "starts mpirun") for name in ("scale", "tradeoff", "verify")),
        ("profile", "draws all ranks"),
        ("kbuffer", "draws all views"),
    ],
)
def test_commands_that_need_no_mpirun_are_not_run_by_it(
    command: str, does: str, cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    outcome = cli(command, FIELD, *(() if command == "verify" else ("-o", "out")))
    assert (outcome.status, f"{does} by itself" in outcome.err) == (2, True)


@pytest.mark.parametrize("command", ["scale", "tradeoff", "profile"])
@pytest.mark.parametrize("library", ["jinja2", "matplotlib"])
def test_a_missing_library_is_named(
    command: str, library: str, cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    outcome = cli(command, FIELD, "-o", str(tmp_path / "out"))
    assert outcome.status == 1
    assert f"reports need {library}: pip install '.[report]' in a checkout of clusterviz" in outcome.err
