"""Output of report pages: folders that appear whole or not at all, HTML from templates, and figures as SVG."""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from clusterviz.errors import ClustervizError, OutputError, installation
from clusterviz.image.replace import behind_links, folder_error, lock_temporary, remove_temporary, temporary_name
from clusterviz.scene import Scene, dump_scene
from clusterviz.scene.files import public_data

PAGE = "index.html"
FILTERS = {
    "count": "{:,}".format,
    "percent": lambda share: f"{100 * share:.1f} %" if share >= 0.0005 else "0",
    "ms": lambda seconds: f"{1e3 * seconds:.1f}",
    "mib": lambda size: f"{size / 2**20:,.2f}",
}
"""Of report pages: how they write numbers."""


@contextmanager
def replacing_folder(path: str | os.PathLike[str], known_by: str) -> Iterator[Path]:
    """Yield a temporary folder beside `path`; it replaces `path` when the block succeeds, else it is removed.

    `path`: the output folder; an empty folder or an older report is replaced. `known_by`: the file that identifies an
    older report. Raises OutputError: `path` is something else, or the folder cannot be made, written (any OSError of
    the block) or renamed.
    """
    target = behind_links(Path(path).absolute())
    temporary = _create(target, known_by)
    try:
        yield temporary
        _rename(temporary, target)
    except OSError as error:
        raise OutputError("cannot be written", where=str(target), found=error.strerror or error) from error
    finally:
        remove_temporary(temporary)


def check_folder(path: str | os.PathLike[str], known_by: str) -> None:
    """Check before measuring that `replacing_folder` can begin. Raises OutputError: see `replacing_folder`."""
    remove_temporary(_create(behind_links(Path(path).absolute()), known_by))


def _create(target: Path, known_by: str) -> Path:
    """Create an empty hidden folder beside the target; refuse targets that hold other files."""
    if target.exists() and not target.is_dir():
        raise OutputError("cannot be a folder", where=str(target), found="a file", allowed="a folder's name")
    if target.is_dir() and any(target.iterdir()) and not (target / known_by).is_file():
        allowed = f"a new name, an empty folder, or one with an older {known_by}, which is replaced"
        raise OutputError("would overwrite other files", where=str(target), found="a folder in use", allowed=allowed)
    temporary = temporary_name(target)
    try:
        temporary.mkdir()
        lock_temporary(temporary)
    except OSError as error:
        raise folder_error(target, error) from error
    return temporary


def _rename(temporary: Path, target: Path) -> None:
    """Replace the old folder by the new one; between two renames there is none."""
    if not target.is_dir():
        os.rename(temporary, target)
        return
    old = temporary_name(target)
    os.rename(target, old)
    try:
        os.rename(temporary, target)
    except OSError:
        os.rename(old, target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def check_libraries() -> None:
    """Check before measuring that the libraries of pages are installed.

    Raises ClustervizError: matplotlib or Jinja2 is not installed.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ClustervizError(f"reports need {error.name}: {installation('report')}") from None


def numbers_of(scene: Scene, **found: Any) -> dict[str, Any]:
    """Return the contents of a report's JSON file: program, scene, and what was found."""
    return {"clusterviz": version("clusterviz"), "scene": public_data(scene), **found}


def write_page(folder: Path, kind: str, numbers: Mapping[str, Any], scene: Scene, /, **values: Any) -> None:
    """Write the numbers of a report, and its page.

    `kind`: folder of the template, which extends `base.html`, and name of the JSON file. `values`: of the template,
    beside those that all pages have.
    """
    json_name = f"{kind}.json"
    (folder / json_name).write_text(json.dumps(numbers, indent=2) + "\n")
    html = page_html(f"{kind}/page.html", scene=dump_scene(scene), size=scene.image.size, json_name=json_name, **values)
    (folder / PAGE).write_text(html, encoding="utf-8")


def page_html(template: str, **values: Any) -> str:
    """Return a page of a template in this folder."""
    import jinja2

    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters |= FILTERS
    return environment.get_template(template).render(version=version("clusterviz"), **values)


def make_figure(width: float, height: float) -> Any:
    """Return a figure without a window; width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def svg_of(figure: Any) -> str:
    """Return a figure as an SVG element for HTML, with text in the page's font."""
    import matplotlib as mpl

    text = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "clusterviz", "font.family": "sans-serif"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]
