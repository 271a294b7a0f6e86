"""Compiled kernels as files: made once, loaded without numba, made again where they are damaged or cannot be kept."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from clusterviz.codec import kernels
from clusterviz.composite.over import job as native
from clusterviz.errors import InputError
from clusterviz.kernels import compiled, objects

NAME = "put"
BLEND = """
import sys
import numpy as np
from clusterviz.codec import CODECS, Rows, pack, unpack
from clusterviz.composite.over.blend import put_before
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.data.store import wavelet
from clusterviz.composite.fragment import Patch
from clusterviz.image.partial import Rect
for codec in CODECS:
    image = np.zeros((640, 4), np.uint8)
    image[100:300] = 7
    assert np.array_equal(unpack(pack(image, codec, Rows(0, 64)), 640, image.dtype, Rows(0, 64)), image)
pixels, out = np.full((8, 4), 128, np.uint8), np.zeros((8, 4), np.uint8)
patch = Patch(8, 0, 8, Rect(0, 0, 8, 1))
put_before(out, patch, pixels, patch)
blend_layers([Layer(patch, pixels)] * 2, patch, out)
print(out[0, 0], "numba" in sys.modules)
"""

HALVES = """
import hashlib
from pathlib import Path
import numpy as np
from clusterviz.composite.over import vector_code
from clusterviz.errors import InputError
from clusterviz.kernels import objects
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.fragment import Patch
from clusterviz.image.partial import Rect
# prepare
halves = np.arange(0x7C00, dtype=np.uint16).view(np.float16)
floats = halves.astype(np.float32)
floats[:-1] = (floats[:-1] + floats[1:]) / 2
near = [floats, np.nextafter(floats, np.float32(0)), np.nextafter(floats, np.float32(1e9))]
for source in (halves, np.concatenate(near)):
    count = len(source)
    pixels = np.stack([source, -source, source, np.zeros_like(source)], axis=1)
    patch, out = Patch(count, 0, count, Rect(0, 0, count, 1)), np.empty((count, 4), np.float16)
    blend_layers([Layer(patch, pixels)], patch, out)
    assert np.array_equal(out, pixels.astype(np.float16))
    print(hashlib.sha256(out.tobytes()).hexdigest())
"""

OTHER_WAY = """
vector_code.HALVES_IN_HARDWARE = False
objects.folders = lambda: (Path({folder!r}),)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder for the files; nothing is loaded yet."""
    native.kernel.cache_clear()
    monkeypatch.setattr(objects, "folders", lambda: (tmp_path / "kept",))
    yield tmp_path / "kept"
    native.kernel.cache_clear()


def test_a_second_process_needs_no_numba() -> None:
    runs = [subprocess.run([sys.executable, "-c", BLEND], capture_output=True, text=True, check=True) for _ in range(2)]
    assert runs[1].stdout.split() == ["192", "False"]


def test_an_array_of_another_type_or_order_is_refused() -> None:
    mask, table = np.zeros(4, np.uint64), np.zeros((8, 2), np.int32)
    assert kernels.find_runs(mask, 0, table) == (0, 0)
    for wrong in (table[::2], table[0], table.astype(np.int64)):
        with pytest.raises(TypeError, match=r"find_runs: int.* instead of int32 with 2 axes"):
            kernels.find_runs(mask, 0, wrong)


@pytest.mark.long
def test_a_damaged_file_is_made_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    native.kernel(NAME).prepare()
    (file,) = folder.iterdir()
    whole, code, names = file.read_bytes(), objects.read_code(file), []
    monkeypatch.setattr(compiled, "compile_kernel", lambda kernel: (names.append(kernel.name), code)[1])
    native.kernel.cache_clear()
    native.kernel(NAME).prepare()
    assert names == []
    for damaged in (b"", whole[:100], whole[:200] + bytes([whole[200] ^ 1]) + whole[201:], whole + b"\0"):
        file.write_bytes(damaged)
        native.kernel.cache_clear()
        native.kernel(NAME).prepare()
        assert names.pop() == "put"
        assert file.read_bytes() == whole


def test_code_that_others_may_have_written_is_made_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another user's file, one that others may write, or one of another kernel or CPU under this name."""
    native.kernel(NAME).prepare()
    (file,) = folder.iterdir()
    assert (folder.stat().st_mode & 0o777, file.stat().st_mode & 0o777) == (0o700, 0o600)
    assert (code := objects.read_code(file)) is not None
    foreign = file.with_name("foreign.o")
    foreign.write_bytes(file.read_bytes())
    assert objects.read_code(foreign) is None
    for path, mode in ((file, 0o620), (file, 0o602), (folder, 0o770)):
        before = path.stat().st_mode
        path.chmod(mode)
        assert objects.read_code(file) is None
        path.chmod(before)
        assert objects.read_code(file) == code
    if os.getuid() == 0:
        os.chown(file, 4711, -1)
    monkeypatch.setattr("os.getuid", lambda: 4712)
    monkeypatch.setattr(objects, "__file__", "/")
    assert objects.read_code(file) is None


@pytest.mark.long
def test_processes_may_compile_a_kernel_at_once(folder: Path) -> None:
    """Each saves the whole file; none reads a part of one."""
    text = (
        "from clusterviz.kernels import objects; from pathlib import Path; import os; "
        f"objects.folders = lambda: (Path({str(folder)!r}),); code = os.urandom(1) * 10**7; "
        "paths = [objects.object_path('put', [bytes([n])]) for n in range(9)]; "
        "[objects._save(path, code) for path in paths]; assert None not in map(objects.read_code, paths)"
    )
    started = [subprocess.Popen([sys.executable, "-c", text]) for _ in range(2)]
    assert [one.wait() for one in started] == [0, 0]
    assert len(list(folder.iterdir())) == 9


def test_the_cpu_can_be_any_of_its_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    own = objects.fingerprint([])
    monkeypatch.setenv(objects.CPU_VARIABLE, "generic")
    assert objects.fingerprint([]) != own
    assert not objects.has_features("avx")
    monkeypatch.setenv(objects.CPU_VARIABLE, "vax")
    with pytest.raises(InputError, match="CLUSTERVIZ_CPU: no such CPU; found vax; allowed generic, native"):
        objects.cpu()


def test_code_beside_the_package_serves_users_who_cannot_write_there(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container image; what is missing there goes into their own folder."""
    native.kernel(NAME).prepare()
    (file,) = folder.iterdir()
    code, names = objects.read_code(file), []
    monkeypatch.setattr(compiled, "compile_kernel", lambda kernel: (names.append(kernel.name), code)[1])
    monkeypatch.setattr(objects, "folders", lambda: (folder, tmp_path / "home"))
    monkeypatch.setattr("os.access", lambda path, mode: False)
    native.kernel.cache_clear()
    native.kernel(NAME).prepare()
    assert (names, (tmp_path / "home").exists()) == ([], False)
    file.unlink()
    native.kernel.cache_clear()
    native.kernel(NAME).prepare()
    assert (names, [each.name for each in (tmp_path / "home").iterdir()]) == (["put"], [file.name])


@pytest.mark.long
def test_where_nothing_can_be_kept_it_works_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    native.kernel.cache_clear()
    monkeypatch.setattr(objects, "folders", lambda: (tmp_path / "file",))
    native.kernel(NAME).prepare()
    native.kernel.cache_clear()


def test_other_sources_or_processors_make_other_files(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = {native.kernel(NAME).path}
    for source in native.SOURCES:
        (tmp_path / f"{source}.py").write_text("changed")
    monkeypatch.setattr(native, "__file__", str(tmp_path / "job.py"))
    native.kernel.cache_clear()
    paths.add(native.kernel(NAME).path)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_name", lambda: "another")
    paths.add(native.kernel(NAME).path)
    assert len(paths) == 3


@pytest.mark.long
def test_processors_without_half_floats_get_the_same_bits(tmp_path: Path) -> None:
    """All halves, and floats around the middle between them, through both ways of converting.

    The usual way is kept with all other kernels; the other one is compiled for this test, which takes seconds.
    """
    outputs = []
    for prepare in ("", OTHER_WAY.format(folder=str(tmp_path))):
        text = HALVES.replace("# prepare", prepare)
        outputs.append(subprocess.run([sys.executable, "-c", text], capture_output=True, check=True).stdout)
    assert outputs[0] == outputs[1]
    assert len(outputs[0]) > 100
