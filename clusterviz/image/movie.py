"""Movie files: MP4 (H.264) by the ffmpeg of imageio-ffmpeg, and animated GIF."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import OutputError, installation
from clusterviz.image.replace import replacing

QUALITY = 8  # of 10
Bytes = NDArray[np.uint8]


def check_encoder(path: Path) -> None:
    """Check early that movies can be encoded.

    Raises
    ------
    OutputError
        There is no encoder.
    """
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        allowed = f"{installation('movie')}, or numbered pictures: -o 'frame_%04d.png'"
        raise OutputError("no encoder for movies", where=str(path), found=error, allowed=allowed) from None


def write_movie(path: Path, pictures: Iterable[Bytes], count: int, frames_per_second: float) -> None:
    """Write a movie in the format of its extension, atomically.

    Parameters
    ----------
    path : ends in .gif, or is encoded as H.264
    pictures : uint8 (h, w, 3), all of one size. H.264 halves the resolution of colour, so an odd side is padded with a
        copy of its last row or column.

    Raises
    ------
    OutputError
        The encoder fails, or the file cannot be written.
    """
    if path.suffix.lower() == ".gif":
        _write_gif(path, pictures, frames_per_second)
        return
    import imageio_ffmpeg

    with replacing(path) as temporary:
        encoder = None
        try:
            for picture in pictures:
                height, width = picture.shape[:2]
                even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
                if encoder is None:
                    size = (even.shape[1], even.shape[0])
                    encoder = imageio_ffmpeg.write_frames(
                        str(temporary), size, fps=frames_per_second, quality=QUALITY, macro_block_size=1,
                        ffmpeg_log_level="quiet",
                    )  # fmt: skip
                    encoder.send(None)
                encoder.send(np.ascontiguousarray(even))
        except OSError as error:
            raise OSError("the encoder stopped: is the disk full?") from error
        finally:
            if encoder is not None:
                encoder.close()
        _check_whole(temporary, count)


def _write_gif(path: Path, pictures: Iterable[Bytes], frames_per_second: float) -> None:
    """Write an endless GIF with 256 colours a picture and times in hundredths of a second."""
    from PIL import Image

    first, *others = (Image.fromarray(picture).quantize() for picture in pictures)
    with replacing(path) as temporary, temporary.open("wb") as file:
        milliseconds = max(10, 10 * round(100 / frames_per_second))
        first.save(file, format="gif", save_all=True, append_images=others, duration=milliseconds, loop=0)


def _check_whole(path: Path, count: int) -> None:
    """Count the frames of a movie: the encoder reports no error if the disk is full at its end."""
    import imageio_ffmpeg

    try:
        written = imageio_ffmpeg.count_frames_and_secs(str(path))[0]
    except (RuntimeError, OSError):
        written = 0
    if written != count:
        raise OSError(f"{written} of {count} frames are in the movie: is the disk full?")
