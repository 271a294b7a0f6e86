"""Files of every format, made by hand: each function writes an array (z, y, x), and its options change the header."""

from __future__ import annotations

import gzip
import lzma
import struct
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import lz4.block
import nibabel
import nrrd as nrrd_library
import numpy as np
import tifffile
import yaml
from data.checks import values

from clusterviz.data import vtk_xml
from clusterviz.data.formats import metaimage as meta

SHORTS = values("<i2")
COMPRESSORS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": lambda block: lz4.block.compress(block, store_size=False),
}
VTI_FORMS = ("ascii", "binary", "base64", "raw")  # the last two appended
VTI_NAMES = {code: name for name, code in vtk_xml.TYPES.items()}
META_NAMES = {code: name for name, code in reversed(meta.TYPES.items())}
MRC_MODES = {"i1": 0, "i2": 1, "f4": 2, "u2": 6, "f2": 12}
VTK_NAMES = {"i1": "char", "u1": "unsigned_char", "i2": "short", "u2": "unsigned_short", "i4": "int"}
VTK_NAMES |= {"u4": "unsigned_int", "i8": "vtktypeint64", "u8": "unsigned_long", "f4": "float", "f8": "double"}
VTK_HEAD = "# vtk DataFile Version 5.1\na title\n{form}\nDATASET STRUCTURED_POINTS\n"
VTK_HEAD += "DIMENSIONS {size}\nSPACING 2 3 4\nORIGIN 1 2 3\n"


def _native(array: np.ndarray) -> str:
    return array.dtype.newbyteorder("=").str[1:]


def _order(array: np.ndarray) -> str:
    return ">" if array.dtype.byteorder == ">" else "<"


def _xyz(array: np.ndarray) -> str:
    return " ".join(map(str, array.shape[::-1]))


def _gzipped(path: Path, content: bytes) -> Path:
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


def raw(path: Path, array: np.ndarray, **keys: object) -> Path:
    path.write_bytes(b"#" * int(keys.get("header_bytes", 0)) + array.tobytes())
    big = {"byte_order": "big"} if _order(array) == ">" else {}
    described = {"shape": list(array.shape), "dtype": array.dtype.newbyteorder("=").name, **big, **keys}
    path.with_name(f"{path.name}.yaml").write_text(yaml.safe_dump(described, default_flow_style=None))
    return path


def nrrd(path: Path, data: np.ndarray | bytes = SHORTS, **fields: str) -> Path:
    """Bytes are of 5 × 6 × 7 shorts unless fields say otherwise; a field "-" is left out."""
    array = SHORTS if isinstance(data, bytes) else data
    kind = {"float32": "float", "float64": "double"}.get(array.dtype.name, array.dtype.name)
    endian = {"<": "little", ">": "big"}[_order(array)]
    known = {"type": kind, "dimension": str(array.ndim), "sizes": _xyz(array), "endian": endian, "encoding": "raw"}
    lines = "".join(f"{key}: {value}\n" for key, value in (known | fields).items() if value != "-")
    content = data if isinstance(data, bytes) else data.tobytes()
    path.write_bytes(f"NRRD0005\n# by hand\n{lines}\n".encode() + content)
    return path


def metaimage(path: Path, data: np.ndarray | bytes = SHORTS, entry: str = "LOCAL", **fields: str) -> Path:
    """Bytes are of 5 × 6 × 7 shorts unless fields say otherwise; a field "" is left out."""
    array = SHORTS if isinstance(data, bytes) else data
    known = {"NDims": str(array.ndim), "DimSize": _xyz(array), "ElementType": META_NAMES[_native(array)]}
    known |= {"BinaryDataByteOrderMSB": "True"} if _order(array) == ">" else {}
    text = "".join(f"{key} = {value}\n" for key, value in (known | fields).items() if value)
    content = data if isinstance(data, bytes) else data.tobytes()
    path.write_bytes(f"{text}ElementDataFile = {entry}\n".encode() + content)
    return path


def nifti(path: Path, array: np.ndarray, affine: np.ndarray | None = None, version: int = 1, **fields: object) -> Path:
    header = (nibabel.Nifti1Header, nibabel.Nifti2Header)[version - 1](endianness=_order(array))
    header.set_data_dtype(array.dtype)
    header.set_data_shape(array.T.shape)
    header["vox_offset"] = header.single_vox_offset
    header.set_sform(np.eye(4) if affine is None else affine, 1)
    for key, value in fields.items():
        header[key] = value
    return _gzipped(path, header.binaryblock + bytes(4) + array.tobytes())


def mrc(path: Path, array: np.ndarray, extended: bytes = b"", **changes: float) -> Path:
    """`changes` sets words of the header, four bytes each: w3=1, w10=2.0."""
    sections, rows, columns = array.shape
    words: dict[int, float] = {0: columns, 1: rows, 2: sections, 3: MRC_MODES[_native(array)], 23: len(extended)}
    words |= {7: columns, 8: rows, 9: sections, 10: 2.0 * columns, 11: 3.0 * rows, 12: 4.0 * sections}
    words |= {13: 90.0, 14: 90.0, 15: 90.0, 16: 1, 17: 2, 18: 3}
    words |= {int(key[1:]): value for key, value in changes.items()}
    header = bytearray(1024)
    for word, value in words.items():
        struct.pack_into(_order(array) + ("i" if isinstance(value, int) else "f"), header, 4 * word, value)
    header[208:216] = b"MAP " + (b"\x11\x11\0\0" if _order(array) == ">" else b"\x44\x44\0\0")
    return _gzipped(path, bytes(header) + extended + array.tobytes())


def hdf5(path: Path, array: np.ndarray, attributes: dict[str, object] | None = None, **options: Any) -> Path:
    with h5py.File(path, "w", libver=options.pop("libver", None)) as file:
        file.create_dataset("density", data=array, **options).attrs.update(attributes or {})
    return path


def vtkhdf(
    path: Path, arrays: dict[str, np.ndarray], section: str = "PointData", steps: Any = None, **changes: Any
) -> Path:
    """An image; `steps` are the places of the time steps in arrays whose first axis is time."""
    z, y, x = (n - (section == "PointData") for n in next(iter(arrays.values())).shape[steps is not None :][:3])
    known = {"Version": (2, 0), "Type": np.bytes_("ImageData"), "WholeExtent": (1, x + 1, 0, y, 0, z)}
    known |= {"Origin": (10.0, 20.0, 30.0), "Spacing": (2.0, 3.0, 4.0), "Direction": (0.0, -1, 0, 1, 0, 0, 0, 0, 1)}
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs.update({key: value for key, value in (known | changes).items() if value is not None})
        for name, array in arrays.items():
            root[f"{section}/{name}"] = array
            if steps is not None:
                root[f"Steps/{section}Offsets/{name}"] = np.array(steps)
        if steps is not None:
            root["Steps/Values"] = np.arange(len(steps)) * 0.5
            root["Steps"].attrs["NSteps"] = len(steps)
    return path


def amr(path: Path, levels: list[tuple[float, dict[tuple[int, ...], np.ndarray]]], **attributes: Any) -> Path:
    """Levels of boxes: a spacing, and cells (z, y, x) by the index of the first cell x, y, z."""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        known = {"Version": (2, 0), "Type": np.bytes_("OverlappingAMR"), "Origin": (1.0, 2.0, 3.0)}
        root.attrs.update(known | {"GridDescription": np.bytes_("XYZ")} | attributes)
        for number, (spacing, boxes) in enumerate(levels):
            group = root.create_group(f"Level{number}")
            group.attrs["Spacing"] = [spacing] * 3
            ends = [[b + n - 1 for b, n in zip(at, cells.shape[::-1], strict=True)] for at, cells in boxes.items()]
            group["AMRBox"] = [
                [n for pair in zip(at, end, strict=True) for n in pair] for at, end in zip(boxes, ends, strict=True)
            ]
            group["CellData/c"] = np.concatenate([cells.ravel() for cells in boxes.values()])
            for section in ("PointData", "FieldData"):
                group.create_group(section)
    return path


def netcdf(path: Path, array: np.ndarray, lines: dict[str, np.ndarray | int], **attributes: object) -> Path:
    """One variable, `t`; a line that is a number is a dimension without coordinates."""
    with h5py.File(path, "w") as file:
        for name, line in lines.items():
            scale = name
            if isinstance(line, int):
                scale = "This is a netCDF dimension but not a netCDF variable.         5"
            file[name] = np.zeros(line, ">f4") if isinstance(line, int) else line
            file[name].make_scale(scale)
        file.create_dataset("t", data=array, chunks=True, compression="gzip")
        for dim, name in zip(file["t"].dims, lines, strict=True):
            dim.attach_scale(file[name])
        file["t"].attrs.update(attributes)
        if "when" in file:
            file["when"].attrs["units"] = "hours since 1900-01-01"
    return path


DICOM_TURNED = np.array([[0.0, 1, 0], [0, 0, -1]])  # directions of rows and columns


def dicom(array: np.ndarray, position: np.ndarray, **elements: Any) -> Any:
    """A picture, as a scanner writes it, or as floats; an element of None is left out."""
    from pydicom import uid
    from pydicom.dataset import Dataset, FileMetaDataset

    found = Dataset()
    found.file_meta = FileMetaDataset()
    found.file_meta.TransferSyntaxUID = elements.pop("syntax", uid.ExplicitVRLittleEndian)
    big = found.file_meta.TransferSyntaxUID == uid.ExplicitVRBigEndian
    bits = array.dtype.itemsize * 8
    known = {"SOPClassUID": uid.CTImageStorage, "SOPInstanceUID": uid.generate_uid(), "SeriesInstanceUID": "1.2.3"}
    known |= {"SamplesPerPixel": 1, "PhotometricInterpretation": "MONOCHROME2", "BitsAllocated": bits}
    known |= {"Rows": array.shape[-2], "Columns": array.shape[-1], "PixelSpacing": [0.75, 0.5], "BitsStored": bits}
    known |= {"ImagePositionPatient": list(position), "ImageOrientationPatient": DICOM_TURNED.ravel().tolist()}
    known |= {"HighBit": bits - 1, "PixelRepresentation": int(array.dtype.kind == "i")}
    if array.dtype.kind == "f":
        known |= dict.fromkeys(("BitsStored", "HighBit", "PixelRepresentation"))
        known["DoubleFloatPixelData" if bits == 64 else "FloatPixelData"] = array.astype(f"<f{bits // 8}").tobytes()
    for key, value in (known | elements).items():
        if value is not None:
            setattr(found, key, value)
    stored = array.astype(array.dtype.newbyteorder("<>"[big])).tobytes()
    if array.dtype.kind != "f":
        found.add_new("PixelData", "OB" if bits == 8 else "OW", stored)
    return found


def save_dicom(found: Any, path: Path) -> Path:
    import pydicom

    pydicom.dcmwrite(path, found, enforce_file_format=True)
    return path


def _vtk_packed(array: np.ndarray, form: str) -> bytes:
    """Text has nine numbers a line, as VTK writes it."""
    if form == "BINARY":
        return array.astype(array.dtype.newbyteorder(">")).tobytes() + b"\n"
    words = [repr(number) for number in array.ravel().tolist()]
    return "".join(" ".join(words[i : i + 9]) + " \n" for i in range(0, len(words), 9)).encode()


def vtk_parts(path: Path, form: str, *parts: str | np.ndarray, head: str = VTK_HEAD, size: str = "7 6 5") -> Path:
    """A legacy file of header lines and arrays."""
    texts = [part.encode() + b"\n" if isinstance(part, str) else _vtk_packed(part, form) for part in parts]
    path.write_bytes(head.format(form=form, size=size).encode() + b"".join(texts))
    return path


def vtk(path: Path, array: np.ndarray, form: str = "BINARY") -> Path:
    lines = (f"POINT_DATA {array.size}", f"SCALARS s {VTK_NAMES[_native(array)]} 1", "LOOKUP_TABLE default")
    return vtk_parts(path, form, *lines, array, size=_xyz(array))


def vti_packed(data: bytes, header: str, compressor: str, text: bool, block: int = 100) -> bytes:
    """The array with its header, as VTK writes it."""
    encode = b64encode if text else bytes
    compress = COMPRESSORS[compressor]
    if compress is None:
        return encode(np.array([len(data)], header).tobytes() + data)
    blocks = [compress(data[begin : begin + block]) for begin in range(0, len(data), block)]
    numbers = [len(blocks), block, len(data) % block, *map(len, blocks)]
    return encode(np.array(numbers, header).tobytes()) + encode(b"".join(blocks))


def vti(
    path: Path,
    arrays: np.ndarray | dict[str, np.ndarray],
    form: str = "raw",
    compressor: str = "",
    header: str = "u8",
    where: str = "PointData",
    image: str = "",
    piece: str = "",
    scalars: str = "",
    extra: str = "",
) -> Path:
    """One array, or several by name, as point or cell data; `header` is the type of the sizes before the samples."""
    arrays = arrays if isinstance(arrays, dict) else {"s": arrays}
    one = next(iter(arrays.values()), SHORTS)
    piece = piece or " ".join(f"0 {n - (where == 'PointData')}" for n in one.shape[::-1])
    image = image or f'WholeExtent="{piece}" Origin="0 0 0" Spacing="1 1 1"'
    active = f'Scalars="{scalars}"' if scalars else ""
    of_piece = f'Extent="{piece}"'
    return vtk_xml(path, "ImageData", of_piece, {where: arrays}, form, compressor, image, header, extra, active)


def vtk_xml(
    path: Path,
    kind: str,
    piece: str,
    sections: Mapping[str, Mapping[str, np.ndarray]],
    form: str = "ascii",
    compressor: str = "",
    whole: str = "",
    header: str = "u4",
    extra: str = "",
    active: str = "",
) -> Path:
    """A file of one piece with arrays by section and name; `piece`, `whole`, `extra` and `active` are attributes."""
    one = next((array for members in sections.values() for array in members.values()), SHORTS)
    tags, appended = "", b""
    for section, members in sections.items():
        tags += f"<{section} {active}>"
        for name, array in members.items():
            more = f'NumberOfComponents="{array.shape[1]}"' if array.ndim == 2 else extra
            start = f'<DataArray type="{VTI_NAMES[_native(array)]}" Name="{name}" {more}'
            data = vti_packed(array.tobytes(), _order(one) + header, compressor, form in VTI_FORMS[:3])
            if form == "ascii":
                tags += f'{start} format="ascii">\n{" ".join(map(repr, array.ravel().tolist()))}\n</DataArray>'
            elif form == "binary":
                key = '<InformationKey name="RANGE" location="x">7</InformationKey>'
                first = tags.endswith(f"<{section} {active}>")
                inner = f"\n {data.decode()}\n  {key} " if first else f"{key}\n  {data.decode()}\n "  # VTK wrote both
                tags += f'{start} format="binary">{inner}</DataArray>'
            else:
                tags += f'{start} format="appended" offset="{len(appended)}"/>'
                appended += data
        tags += f"</{section}>"
    order, packing = {"<": "Little", ">": "Big"}[_order(one)], f'compressor="{compressor}"' if compressor else ""
    packing += ' header_type="UInt64"' if header == "u8" else ""
    text = f'<?xml version="1.0"?>\n<VTKFile type="{kind}" byte_order="{order}Endian" {packing}><{kind} {whole}>'
    content = f"{text}<Piece {piece}>{tags}</Piece></{kind}>".encode()
    if appended:
        encoding = "base64" if form == "base64" else "raw"
        content += f'<AppendedData encoding="{encoding}">\n   _'.encode() + appended + b"\n</AppendedData>"
    path.write_bytes(content + b"</VTKFile>")
    return path


def vtk_cells(key: str, rows: Any, version: int) -> list[str | np.ndarray]:
    """Lines and arrays of cells in a legacy file of a version."""
    if version == 5:
        ends = np.cumsum([0, *map(len, rows)])
        head = [f"{key} {len(ends)} {ends[-1]}", "OFFSETS vtktypeint64", ends, "CONNECTIVITY vtktypeint64"]
        return [*head, np.concatenate(rows)]
    mixed = np.concatenate([[len(row), *row] for row in rows]).astype("i4")
    return [f"{key} {len(rows)} {len(mixed)}", mixed]


def npy(path: Path, array: np.ndarray) -> None:
    np.save(path, array)


def npz(path: Path, array: np.ndarray, save: Callable[..., object] = np.savez) -> None:
    save(path, density=array)


def tiff(path: Path, array: np.ndarray, **options: object) -> None:
    order = array.dtype.byteorder if array.dtype.byteorder in "<>" else "="
    tifffile.imwrite(path, array, **{"byteorder": order, "photometric": "minisblack", **options})


def pynrrd(path: Path, array: np.ndarray, **header: object) -> None:
    """By the library that users have."""
    nrrd_library.write(str(path), array, header, index_order="C")


def packed_metaimage(
    path: Path, array: np.ndarray, pack: Callable[[bytes], bytes] = zlib.compress, **fields: str
) -> None:
    data = pack(array.tobytes())
    known = {"DimSize": _xyz(array), "ElementType": META_NAMES[_native(array)], "CompressedData": "True"}
    metaimage(path, data, **(known | {"CompressedDataSize": str(len(data))} | fields))


BY_SUFFIX = {f".{write.__name__}": write for write in (npy, npz, raw, nrrd, mrc, vtk, vti)}
BY_SUFFIX |= {".map": mrc, ".ccp4": mrc, ".nii": nifti, ".mha": metaimage, ".h5": hdf5, ".tif": tiff}


def write(path: Path, array: np.ndarray = SHORTS, by: Callable[..., object] | None = None, **options: Any) -> Path:
    """A file of the format that its name says, or by another writer."""
    (by or BY_SUFFIX[path.with_name(path.name.removesuffix(".gz")).suffix])(path, array, **options)
    return path
