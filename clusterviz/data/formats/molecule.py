"""Atoms of PDB, mmCIF and .xyz files, as points; gemmi, of the extra `molecules`, reads the first two.

The first model is read, and of alternative positions the first. Units are ångström. Attributes: `radius` (van der
Waals), `element` (atomic number), `RGB` (by element, as Jmol), `b_factor`, `occupancy`, `residue` and `chain` (their
numbers in the file, from 0); of .xyz files the first three alone.

References
----------
M. Wojdyr: GEMMI: A library for structural biology, JOSS 7(73), 2022 (the radii are its own).
Jmol: Colors, table of element colours.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import library, readable
from clusterviz.data.geometry import Geometry, Points
from clusterviz.errors import DataError, warn_of_data

COLOURS = {
    "H": 0xFFFFFF, "C": 0x909090, "N": 0x3050F8, "O": 0xFF0D0D, "F": 0x90E050, "Na": 0xAB5CF2, "Mg": 0x8AFF00,
    "P": 0xFF8000, "S": 0xFFFF30, "Cl": 0x1FF01F, "K": 0x8F40D4, "Ca": 0x3DFF00, "Mn": 0x9C7AC7, "Fe": 0xE06633,
    "Co": 0xF090A0, "Ni": 0x50D050, "Cu": 0xC88033, "Zn": 0x7D80B0, "Se": 0xFFA100, "Br": 0xA62929, "I": 0x940094,
}  # fmt: skip
OTHER = 0xFF1493
NUMBER = re.compile(rb" *[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)? *")


def read_molecule(path: Path) -> Geometry:
    where = str(path)
    gemmi = library("gemmi", "molecules", where)
    if path.name.lower().removesuffix(".gz").endswith((".pdb", ".ent")):
        _check_pdb(path)
    structure = gemmi.read_structure(where)
    if not len(structure) or not structure[0].count_atom_sites():
        raise DataError("no atoms", where=where, allowed="ATOM and HETATM records, or _atom_site")
    structure.remove_alternative_conformations()
    rows, elements, residues = list[Any](), list[Any](), -1
    for chain_number, chain in enumerate(structure[0]):
        for residue in chain:
            residues += 1
            for atom in residue:
                place, element = atom.pos, atom.element
                rows.append(
                    (place.x, place.y, place.z, atom.b_iso, atom.occ, element.atomic_number, residues, chain_number)
                )
                elements.append(element)
    table = np.array(rows, np.float64).reshape(-1, 8)
    whole = {name: table[:, n].astype(np.int32) for n, name in ((6, "residue"), (7, "chain"))}
    attributes = {**_attributes(elements), "b_factor": table[:, 3], "occupancy": table[:, 4], **whole}
    return Geometry(points=Points(where, np.ascontiguousarray(table[:, :3]), attributes))


def atoms_of_xyz(file: TextIO, count: int, where: str) -> Geometry:
    """Read the atoms of an .xyz file, of its first frame.

    Parameters
    ----------
    file : behind its first line, the number of atoms
    """
    gemmi, _ = library("gemmi", "molecules", where), file.readline()
    lines = [line.split() for line in islice(file, count)]
    if len(lines) < count:
        raise DataError("truncated", where=where, found=f"{len(lines)} atoms", allowed=count)
    if next(filter(str.strip, file), ""):
        warn_of_data("of several frames the first one is read", where=where)
    for words in lines:
        if len(words) < 4 or not all(NUMBER.fullmatch(word.encode()) for word in words[1:4]):
            allowed = "an element, x, y and z"
            raise DataError("not an atom", where=where, found=" ".join(words), allowed=allowed)
    elements = [gemmi.Element(int(word) if word.isdecimal() else word) for word in (words[0] for words in lines)]
    positions = np.array([words[1:4] for words in lines], "S").astype(np.float64).reshape(-1, 3)
    return Geometry(points=Points(where, positions, _attributes(elements)))


def _attributes(elements: Sequence[Any]) -> dict[str, NDArray[Any]]:
    colour = np.array([COLOURS.get(element.name, OTHER) for element in elements], np.uint32)
    return {
        "radius": np.array([element.vdw_r for element in elements], np.float64),
        "RGB": np.stack([colour >> 16 & 255, colour >> 8 & 255, colour & 255], axis=1).astype(np.uint8),
        "element": np.array([element.atomic_number for element in elements], np.int32),
    }


def _check_pdb(path: Path) -> None:
    """Check that atoms have positions: gemmi takes what is no number as 0."""
    with readable(path), gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
        for number, line in enumerate(file, 1):
            words = [line[begin : begin + 8] for begin in (30, 38, 46)]
            if line[:6].upper() in (b"ATOM  ", b"HETATM") and not all(map(NUMBER.fullmatch, words)):
                found = b"".join(words).decode("utf-8", "replace")
                raise DataError(f"no position in line {number}", where=str(path), found=repr(found), allowed="numbers")
