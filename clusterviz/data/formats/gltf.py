"""glTF 2.0 (.gltf, .glb): the triangles, lines and points of a scene, placed by its tree of nodes.

Buffers lie in the file, in data: URIs or in files beside it. Attributes that all primitives of a kind have are kept:
NORMAL (as `Normals`), colours and the application's own. Meshes are morphed by their weights, and repeated by
EXT_mesh_gpu_instancing. Materials, textures, skins and animations are ignored, with a warning; compressed accessors are
refused.

References
----------
Khronos Group: glTF 2.0 Specification, ISO/IEC 12113:2022.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import read_file
from clusterviz.data.geometry import (
    Geometry,
    Lines,
    Mesh,
    Points,
    check_indices,
    joined_arrays,
    triangulate,
    triangulate_strips,
)
from clusterviz.data.header import check_packed, check_size
from clusterviz.errors import DataError, warn_of_data

TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
INSTANCING = "EXT_mesh_gpu_instancing"
READ_EXTENSIONS = {INSTANCING, "KHR_mesh_quantization"}
UNREAD = ("materials", "textures", "skins", "animations")
"""Lists of a document that are not used."""
AXES = "RSA"
"""Directions of x, y and z: y is up, and +z the front (section 3.4); a picture of the front has +x on its right."""
MODES = ("points", "lines", "loop", "strip", "triangles", "triangle strip", "triangle fan")


@dataclass(frozen=True)
class _Primitive:
    """Vertices (n, 3) in the world, their attributes, the mode, and the indices (k,) of the corners."""

    vertices: NDArray[Any]
    attributes: dict[str, NDArray[Any]]
    mode: str
    indices: NDArray[np.int64]


def read_gltf(path: Path) -> Geometry:
    file = _File(path)
    required = [str(name) for name in file.document.get("extensionsRequired", []) if name not in READ_EXTENSIONS]
    if required:
        found, allowed = f"required extensions {', '.join(required)}", ", ".join(sorted(READ_EXTENSIONS))
        raise DataError("unsupported", where=file.where, found=found, allowed=allowed)
    if unread := [key for key in UNREAD if file.document.get(key)]:
        warn_of_data("not read", where=file.where, found=", ".join(unread))
    parts = [part for node, matrix in file.instances() for part in file.primitives(node, matrix)]
    meshes = [part for part in parts if part.mode.startswith("triangle")]
    lines = [part for part in parts if part.mode in ("lines", "loop", "strip")]
    points = [part for part in parts if part.mode == "points"]
    return Geometry(
        _mesh(meshes, file.where) if meshes else None,
        _lines(lines, file.where) if lines else None,
        _points(points, file.where) if points else None,
        AXES,
    )


class _File:
    """A document and its buffers."""

    def __init__(self, path: Path) -> None:
        self.path, self.where = path, str(path)
        content = read_file(path)
        self.binary, text = b"", content
        if content[:4] == b"glTF":
            text = self._unpack(content)
        document = json.loads(text)
        if not isinstance(document, dict) or not str(document.get("asset", {}).get("version", "")).startswith("2."):
            raise DataError("not glTF 2.0", where=self.where, allowed='{"asset": {"version": "2.0"}, …}')
        self.document: dict[str, Any] = document
        self.buffers: dict[int, bytes] = {}

    def _unpack(self, content: bytes) -> bytes:
        """Return the JSON of a .glb file, and keep its binary chunk."""
        check_size(len(content), 20, self.where)
        version, length = struct.unpack_from("<2I", content, 4)
        if version != 2:
            raise DataError("not glTF 2.0", where=self.where, found=f"version {version}", allowed="2")
        check_size(len(content), length, self.where, exact=True)
        at, chunks = 12, dict[bytes, bytes]()
        while at + 8 <= length:
            count, kind = struct.unpack_from("<I4s", content, at)
            check_size(length, at + 8 + count, self.where)
            chunks.setdefault(kind, content[at + 8 : at + 8 + count])
            at += 8 + count
        self.binary = chunks.get(b"BIN\0", b"")
        return chunks.get(b"JSON", b"")

    def entry(self, key: str, number: Any) -> dict[str, Any]:
        entries = self.document.get(key, [])
        if not isinstance(number, int) or not 0 <= number < len(entries):
            allowed = f"0 to {len(entries) - 1}" if entries else "none"
            raise DataError(f"no such entry of {key}", where=self.where, found=number, allowed=allowed)
        entry: dict[str, Any] = entries[number]
        return entry

    def instances(self) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
        """Return the scene's nodes with meshes, and their matrices float64 (4, 4), depth first."""
        nodes = self.document.get("nodes", [])
        if self.document.get("scenes"):
            roots = self.entry("scenes", self.document.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [number for number in range(len(nodes)) if number not in children]
            if nodes and not roots:
                raise DataError("the nodes are no tree", where=self.where, found="each is a child of another")
        waiting, seen, found = [(root, np.eye(4)) for root in reversed(roots)], set[int](), []
        while waiting:
            number, parent = waiting.pop()
            node = self.entry("nodes", number)
            if number in seen:
                raise DataError("the nodes are no tree", where=self.where, found=f"node {number} is reached twice")
            seen.add(number)
            matrix = parent @ _matrix(node)
            if "mesh" in node:
                found += [(node, matrix @ own) for own in self.own_instances(node)]
            waiting += [(child, matrix) for child in reversed(node.get("children", []))]
        return found

    def own_instances(self, node: dict[str, Any]) -> list[NDArray[np.float64]]:
        given = node.get("extensions", {}).get(INSTANCING, {}).get("attributes", {})
        keys = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        columns = {keys[name]: self.accessor(number) for name, number in given.items() if name in keys}
        if not columns:
            return [np.eye(4)]
        return [_matrix(dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]

    def morphed(self, primitive: dict[str, Any], name: str, array: NDArray[Any], weights: Any) -> NDArray[Any]:
        """Return an attribute of a primitive, moved towards its targets by their weights."""
        targets = primitive.get("targets", [])
        used = [(weight, each[name]) for weight, each in zip(weights, targets, strict=False) if weight and name in each]
        for weight, number in used:
            array = array + np.float32(weight) * self.accessor(number)
        return array

    def primitives(self, node: dict[str, Any], matrix: NDArray[np.float64]) -> list[_Primitive]:
        found, mesh = [], self.entry("meshes", node["mesh"])
        weights = node.get("weights", mesh.get("weights", []))
        for each in mesh.get("primitives", []):
            if not 0 <= each.get("mode", 4) < len(MODES):
                raise DataError("unknown mode", where=self.where, found=each["mode"], allowed=f"0 to {len(MODES) - 1}")
            arrays = {
                name: self.morphed(each, name, self.accessor(number), weights)
                for name, number in each.get("attributes", {}).items()
                if name in ("POSITION", "NORMAL") or name.startswith(("COLOR_", "_"))
            }
            if arrays.get("POSITION", np.empty(0)).ndim != 2:
                raise DataError("a primitive has no positions", where=self.where, allowed="POSITION, VEC3")
            vertices: NDArray[Any] = arrays.pop("POSITION").astype(np.float32, copy=False)
            if (matrix != np.eye(4)).any():
                vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            if "NORMAL" in arrays:
                # Normals keep their angles to the surface under the cofactors, which exist for singular matrices too.
                a, b, c = matrix[:3, :3].T
                cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
                arrays["Normals"] = arrays.pop("NORMAL") @ cofactors.T
            indices = np.arange(len(vertices))
            if "indices" in each:
                indices = self.accessor(each["indices"]).astype(np.int64).reshape(-1)
            check_indices(indices, len(vertices), self.where)
            mode = MODES[each.get("mode", 4)]
            if mode.startswith("triangle") and np.linalg.det(matrix[:3, :3]) < 0:
                mode += ", mirrored"
            found.append(_Primitive(vertices, arrays, mode, indices))
        return found

    def accessor(self, number: Any) -> NDArray[Any]:
        """Return the numbers (n,) or tuples (n, components) of an accessor; normalised ones as float32."""
        entry = self.entry("accessors", number)
        if entry.get("componentType") not in TYPES or entry.get("type") not in COMPONENTS:
            found = f"{entry.get('componentType')} {entry.get('type')}"
            raise DataError("unknown type of an accessor", where=self.where, found=found, allowed=f"{[*TYPES]}")
        dtype, components = np.dtype(TYPES[entry["componentType"]]), COMPONENTS[entry["type"]]
        count, sparse = entry["count"], entry.get("sparse")
        if "bufferView" in entry:
            array = self.view(entry, dtype, components, count)
        elif sparse is not None:
            check_packed(
                sum(view["byteLength"] for view in self.document.get("bufferViews", [])), count, "text", self.where
            )
            array = np.zeros((count, components), dtype)
        else:
            raise DataError("unsupported", where=self.where, found="an accessor without data", allowed="a buffer view")
        if sparse is not None:
            places = self.view(
                sparse["indices"], np.dtype(TYPES[sparse["indices"]["componentType"]]), 1, sparse["count"]
            )
            check_indices(places, count, self.where)
            array = array.copy()
            array[places[:, 0]] = self.view(sparse["values"], dtype, components, sparse["count"])
        if entry.get("normalized") and dtype.kind != "f":
            array = np.maximum(array / np.float32(np.iinfo(dtype).max), -1)
        return array[:, 0].copy() if components == 1 else array.copy()

    def view(self, entry: dict[str, Any], dtype: np.dtype[Any], components: int, count: int) -> NDArray[Any]:
        view = self.entry("bufferViews", entry["bufferView"])
        begin, offset = view.get("byteOffset", 0), entry.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * components)
        if min(begin, offset, count, view["byteLength"]) < 0 or stride < dtype.itemsize * components:
            raise DataError("an impossible size of an accessor", where=self.where, found=[begin, offset, count, stride])
        data = self.buffer(view["buffer"])
        check_size(len(data), begin + view["byteLength"], self.where)
        check_size(view["byteLength"], offset + stride * (count - 1) + dtype.itemsize * components, self.where)
        return np.ndarray((count, components), dtype, data, begin + offset, (stride, dtype.itemsize))

    def buffer(self, number: Any) -> bytes:
        entry = self.entry("buffers", number)
        if number in self.buffers:
            return self.buffers[number]
        uri = entry.get("uri")
        if uri is None:
            data = self.binary
        elif uri.startswith("data:"):
            data = base64.b64decode(uri.partition(",")[2], validate=True)
        else:
            data = read_file(self.path.parent / unquote(uri))
        check_size(len(data), entry["byteLength"], f"{self.where}: buffer {number}")
        self.buffers[number] = data
        return data


def _matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a node: its own, or translation · rotation · scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found = np.eye(4)
    found[:3, :3] = np.array(rotation) * node.get("scale", (1, 1, 1))
    found[:3, 3] = node.get("translation", (0, 0, 0))
    return found


def _joined(parts: list[_Primitive]) -> tuple[NDArray[Any], dict[str, NDArray[Any]], list[int]]:
    attributes = joined_arrays([part.attributes for part in parts])
    begins = np.cumsum([0, *(len(part.vertices) for part in parts)]).tolist()
    return np.concatenate([part.vertices for part in parts]), attributes, begins[:-1]


def _mesh(parts: list[_Primitive], where: str) -> Mesh:
    vertices, attributes, begins = _joined(parts)
    found = []
    for part, begin in zip(parts, begins, strict=True):
        kind, _, mirrored = part.mode.partition(", ")
        if kind == "triangles":
            if len(part.indices) % 3:
                count = f"{len(part.indices)} indices"
                raise DataError("a triangle is not complete", where=where, found=count, allowed="a multiple of 3")
            triangles: NDArray[np.integer[Any]] = part.indices.reshape(-1, 3)
        else:
            cut = triangulate_strips if kind == "triangle strip" else triangulate
            triangles = cut(np.array([0, len(part.indices)]), part.indices)[0]
        found.append((triangles[:, ::-1] if mirrored else triangles) + begin)
    return Mesh(where, vertices, np.concatenate(found), attributes)


def _lines(parts: list[_Primitive], where: str) -> Lines:
    vertices, attributes, begins = _joined(parts)
    order, lengths = [], list[int]()
    for part, begin in zip(parts, begins, strict=True):
        indices = part.indices + begin
        if part.mode == "lines":
            lengths += [2] * (len(indices) // 2)
            indices = indices[: len(indices) // 2 * 2]
        else:
            indices = np.append(indices, indices[:1]) if part.mode == "loop" else indices
            lengths.append(len(indices))
        order.append(indices)
    along, offsets = np.concatenate(order), np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return Lines(where, vertices[along], offsets, {name: array[along] for name, array in attributes.items()})


def _points(parts: list[_Primitive], where: str) -> Points:
    vertices, attributes, begins = _joined(parts)
    chosen = np.concatenate([part.indices + begin for part, begin in zip(parts, begins, strict=True)])
    return Points(where, vertices[chosen], {name: array[chosen] for name, array in attributes.items()})
