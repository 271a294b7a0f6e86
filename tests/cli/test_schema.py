"""`schema` prints JSON Schema and nothing else."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any


def test_schema_is_json_that_names_every_section(cli: Callable[..., Any]) -> None:
    outcome = cli("schema")
    schema = json.loads(outcome.out)
    assert outcome.status == 0
    assert list(schema["properties"]) == [
        "volumes",
        "automatic",
        "lights",
        "clip",
        "camera",
        "image",
        "quality",
        "cluster",
    ]
    assert schema["$defs"]["Quality"]["properties"]["step"]["exclusiveMinimum"] == 0
