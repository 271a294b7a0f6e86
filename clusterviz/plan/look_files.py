"""Files of users' looks: each is checked once, and what became of it is kept beside the object files."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

from clusterviz.errors import InputError, guard
from clusterviz.input_files import require_regular_file
from clusterviz.kernels.objects import kept
from clusterviz.spmd.look import Look
from clusterviz.spmd.machine_code import compiler_files

MOST_BYTES = 1 << 16  # of a file


def read_look(path: str) -> Look:
    """Return the look of a file.

    Raises InputError: the file cannot be read, or the first mistake in it, with line and column.
    """
    with guard(InputError, path):
        require_regular_file(path)
        try:
            status = os.stat(path)
            return _read(path, status.st_mtime_ns, status.st_size)
        except OSError as error:
            raise InputError(f"cannot read the shader: {error.strerror}", where=path) from None


@lru_cache(maxsize=8)
def _read(path: str, changed: int, size: int) -> Look:
    """Return the look of a file; it is kept until the file changes."""
    data = Path(path).read_bytes()[: MOST_BYTES + 1]
    if len(data) > MOST_BYTES:
        raise InputError("too long", where=path, allowed=f"up to {MOST_BYTES} bytes")
    try:
        text = data.decode().replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError("not a text", where=path) from None

    def make() -> bytes:
        # The compiler takes a while to import, and to read a text.
        from clusterviz.spmd.look_checks import make_look

        return json.dumps(asdict(make_look(text, path))).encode()

    digest = hashlib.sha256(b"\0".join((data, *compiler_files()))).hexdigest()[:24]
    found = json.loads(kept(f"look-{digest}.json", make))
    return Look(**found | {"names": tuple(found["names"])})
