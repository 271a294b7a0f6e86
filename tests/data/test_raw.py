from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from data.checks import DTYPES, check_placed, check_source, cut, refused, values

from clusterviz.data import open_source


def write(folder: Path, array: np.ndarray, **keys: object) -> Path:
    path = folder / "a.raw"
    path.write_bytes(b"#" * int(keys.get("header_bytes", 0)) + array.tobytes())
    described = {"shape": list(array.shape), "dtype": array.dtype.newbyteorder("=").name, **keys}
    path.with_name("a.raw.yaml").write_text(yaml.safe_dump(described))
    return path


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_in_either_byte_order(tmp_path: Path, dtype: str, order: str) -> None:
    array = values(("<" if order == "little" else ">") + dtype)
    check_source(open_source(write(tmp_path, array, byte_order=order, header_bytes=13)), array)


def test_placement(tmp_path: Path) -> None:
    turned = [0, -1, 0, 1, 0, 0, 0, 0, 1]
    source = open_source(write(tmp_path, values("u1"), spacing=[2, 3, 0.5], origin=[1, 2, 3], direction=turned))
    check_placed(source, np.array([[0, -3, 0, 1], [2, 0, 0, 2], [0, 0, 0.5, 3], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"colour": 1}, ("unknown key", "colour", "header_bytes")),
        ({"dtype": "uint7"}, ("impossible dtype", "uint7")),
        ({"dtype": "complex64"}, ("not a scalar volume",)),
        ({"byte_order": "middle"}, ("impossible byte_order", "middle", "little, big")),
        ({"shape": [5, 6, -7]}, ("impossible shape",)),
        ({"shape": "big"}, ("impossible shape",)),
        ({"shape": [5, 0, 7]}, ("no samples",)),
        ({"shape": [5, 6, 7, 1]}, ("several time steps", "time: 0 to 4")),
        ({"shape": [2, 3, 4, 5, 6, 7]}, ("6 axes",)),
        ({"header_bytes": -1}, ("impossible header_bytes",)),
        ({"spacing": [1, 1]}, ("three finite numbers",)),
        ({"spacing": [1, 0, 1]}, ("singular placement",)),
        ({"origin": ["a", 0, 0]}, ("three finite numbers",)),
        ({"direction": [1, 0, 0, 1, 0, 0, 0, 0, 1]}, ("singular placement",)),
        ({"direction": [1, 2]}, ("impossible direction",)),
        ({"shape": [5, 6, 8]}, ("truncated", "840 bytes", "960")),
        ({"shape": [5, 6, 6]}, ("longer than the header says",)),
    ],
)
def test_a_wrong_sidecar(tmp_path: Path, keys: dict[str, object], parts: tuple[str, ...]) -> None:
    path = write(tmp_path, values("f4"))
    described = yaml.safe_load(path.with_name("a.raw.yaml").read_text()) | keys
    path.with_name("a.raw.yaml").write_text(yaml.safe_dump(described))
    refused(lambda: open_source(path), "a.raw", *parts)


@pytest.mark.parametrize(
    ("text", "part"), [("[1", "not YAML"), ("- 1", "keys and values"), ("dtype: uint8", "missing key"), ("", "empty")]
)
def test_a_damaged_sidecar(tmp_path: Path, text: str, part: str) -> None:
    path = write(tmp_path, values("u1"))
    path.with_name("a.raw.yaml").write_text(text)
    refused(lambda: open_source(path), part, "a.raw.yaml")


def test_no_sidecar_truncated_and_arrays_named(tmp_path: Path) -> None:
    path = write(tmp_path, values("u1"))
    refused(lambda: open_source(path, "a"), "no such array")
    refused(lambda: open_source(cut(path, 1)), "truncated")
    path.with_name("a.raw.yaml").unlink()
    refused(lambda: open_source(path), "needs a sidecar", "a.raw.yaml")


def test_a_file_larger_than_memory_is_read_by_the_box(tmp_path: Path) -> None:
    path = write(tmp_path, np.zeros((1, 1, 1), np.uint8))
    path.with_name("a.raw.yaml").write_text("{shape: [20, 32768, 32768], dtype: uint8}")
    patch = values("u1", (1, 1, 9))
    with path.open("r+b") as file:
        file.truncate(20 << 30)
        file.seek(((19 << 15) + 32767 << 15) + 32759)
        file.write(patch.tobytes())
    np.testing.assert_array_equal(open_source(path).read((19, 32767, 32759), (20, 32768, 32768)), patch)
