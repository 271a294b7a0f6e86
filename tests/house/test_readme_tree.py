"""The tree in the README is the tree on the disk: a reader who trusts it is never led to a file that is not there."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[2]
HEADING = "## The house"
LINE = re.compile(r"^(?P<indent>(?:  )*)(?P<name>[\w.-]+/?)\s{2,}(?P<comment>\S.*)$")


def described() -> dict[PurePosixPath, str]:
    """Path and comment of each line of the tree block: two spaces a level, a name, two spaces or more, a comment."""
    section = (ROOT / "README.md").read_text().partition(f"\n{HEADING}\n")[2].partition("\n## ")[0]
    block = section.partition("```text\n")[2].partition("\n```")[0]
    found: dict[PurePosixPath, str] = {}
    folders: list[str] = []
    for line in filter(str.strip, block.splitlines()):
        parts = LINE.match(line)
        assert parts, f"not 'name  comment': {line!r}"
        depth = len(parts["indent"]) // 2
        assert depth <= len(folders), f"no folder above: {line!r}"
        folders[depth:] = [parts["name"].rstrip("/")] if parts["name"].endswith("/") else []
        above = folders[:depth]
        path = PurePosixPath(*above, parts["name"])
        assert path not in found, f"twice: {path}"
        found[path] = parts["comment"]
    return found


def on_disk() -> set[PurePosixPath]:
    """Tracked files, and the folders that hold them; a room's __init__ is told by the room's own line."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    files = {PurePosixPath(name) for name in listed.stdout.split("\0") if name and (ROOT / name).exists()}
    folders = {parent for file in files for parent in file.parents} - {PurePosixPath(".")}
    return {path for path in files | folders if path.name != "__init__.py"}


def open_folders(named: set[PurePosixPath], present: set[PurePosixPath]) -> set[PurePosixPath]:
    """Folders that the tree shows from inside: those it names a child of, and the whole package in any case."""
    package = {path for path in present if path.parts[0] == "clusterviz" and (ROOT / path).is_dir()}
    return {path.parent for path in named} | package | {PurePosixPath(".")}


def test_tree_names_every_file_and_no_other() -> None:
    named, present = set(described()), on_disk()
    shown = open_folders(named, present)
    expected = {path for path in present if path.parent in shown}
    assert named, f"README.md has no section '{HEADING}' with a text block"
    assert sorted(map(str, expected - named)) == [], "missing in the README's tree"
    assert sorted(map(str, named - expected)) == [], "in the README's tree, but not on the disk"
