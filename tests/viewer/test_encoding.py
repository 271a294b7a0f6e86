"""A still picture arrives byte for byte as `render` writes it, a moving one nearly so."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from clusterviz.image.files import write_image
from clusterviz.image.finish import Colour
from clusterviz.viewer.encoding import CHECKERBOARD_MEAN, LOSSLESS, LOSSY, Encoding, Picture
from clusterviz.viewer.messages import unpack

BLUE: Colour = (0.1, 0.2, 0.4)


def smooth(height: int, width: int) -> NDArray[np.float32]:
    """Premultiplied picture without edges, opaque on the left and clear on the right."""
    y, x = np.mgrid[0:height, 0:width] / np.float32(max(height, width))
    alpha = 1 - x
    return np.stack([alpha * x, alpha * y, alpha * (x + y) / 2, alpha], axis=-1).astype(np.float32)


def shown(rgba: NDArray[np.float32], background: Colour | None, encoding: Encoding) -> NDArray[np.uint8]:
    picture = Picture(rgba, background, 1, 0, {}, encoding is LOSSLESS, {}, 0.0)
    return np.asarray(Image.open(io.BytesIO(unpack(picture.message(encoding, 1))[1])))


@pytest.mark.parametrize("background", [BLUE, None])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 500), (61, 47)])
def test_still_picture_is_that_of_render(background: Colour | None, height: int, width: int, tmp_path: Path) -> None:
    rgba = smooth(height, width)
    write_image(tmp_path / "picture.png", rgba, background)
    with Image.open(tmp_path / "picture.png") as file:
        assert (shown(rgba, background, LOSSLESS) == np.asarray(file)).all()


@pytest.mark.parametrize("encoding", LOSSY, ids=str)
@pytest.mark.parametrize("background", [BLUE, None])
def test_moving_picture_is_near(background: Colour | None, encoding: Encoding) -> None:
    rgba = smooth(96, 160)
    over = rgba[..., :3] + (1 - rgba[..., 3:]) * np.array(background or CHECKERBOARD_MEAN)
    found = shown(rgba, background, encoding)
    assert found.shape == (96 // encoding.reduction, 160 // encoding.reduction, 3)
    large = np.repeat(np.repeat(found, encoding.reduction, axis=0), encoding.reduction, axis=1)
    assert np.abs(large - over * 255).mean() < 4


def test_encodings_get_smaller() -> None:
    rgba = smooth(300, 400) + np.random.default_rng(1).normal(0, 0.02, (300, 400, 1)).astype(np.float32)
    picture = Picture(rgba, BLUE, 1, 0, {}, False, {}, 0.0)
    sizes = [len(picture.message(encoding, 1)) for encoding in (LOSSLESS, *LOSSY)]
    assert sizes == sorted(sizes, reverse=True)


def test_header_tells_each_client_its_own_input() -> None:
    picture = Picture(smooth(4, 6), BLUE, 7, 3, {1: 12, 2: 5}, True, {"view_angle": 30.0}, 0.25)
    headers = {client: unpack(picture.message(LOSSLESS, client))[0] for client in (1, 2, 3)}
    assert {client: header["input"] for client, header in headers.items()} == {1: 12, 2: 5, 3: 0}
    known = {"kind": "picture", "picture": 7, "revision": 3, "still": True, "width": 6, "height": 4, "format": "png"}
    assert headers[1] == {**known, "input": 12, "camera": {"view_angle": 30.0}, "seconds": 0.25}
