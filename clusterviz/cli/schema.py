"""`clusterviz schema`: print the JSON Schema of scene files."""

from __future__ import annotations

import json

from clusterviz.cli.console import print_document
from clusterviz.scene import scene_schema


def command() -> None:
    """Print the JSON Schema of scene files: every key, its type, default and meaning."""
    print_document(json.dumps(scene_schema(), indent=2, ensure_ascii=False) + "\n")
