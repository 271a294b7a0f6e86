"""The example notebooks, run by a kernel of this Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "examples/notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))

# What each notebook has made, in the terms of its variables; a failed check is a failed cell.
CHECKS = {
    "first_look": "assert np.array_equal(picture, rendered) and rendered.max() > 0",
    "link_to_widgets": """
import numpy as np
assert right.camera["position"] == [0.0, -2.5, 1.5]
assert scenes[0].volumes[0].clim == scenes[1].volumes[0].clim == (0.2, 0.8)
for picture, scene in zip(pictures, scenes, strict=True):
    rendered = clusterviz.render(scene, size=(120, 90))
    assert np.array_equal(picture, rendered) and rendered.max() > 0
""",
}


def test_each_notebook_has_a_check() -> None:
    assert set(CHECKS) == set(NOTEBOOKS)


@pytest.mark.fresh
@pytest.mark.gl
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name: str, tmp_path: Path) -> None:
    notebook: Any = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)  # type: ignore[no-untyped-call]
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in cells)
    notebook.cells.append(nbformat.v4.new_code_cell(CHECKS[name]))  # type: ignore[no-untyped-call]
    NotebookClient(notebook, timeout=100, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    shown = {kind for cell in cells for output in cell.outputs for kind in output.get("data", {})}
    assert {"application/vnd.jupyter.widget-view+json", "image/png"} <= shown
    errors = [output.text for cell in cells for output in cell.outputs if output.get("name") == "stderr"]
    assert errors == []
