"""docs/concepts/compositing.md agrees with the manuals and the schedules of the algorithms."""

from __future__ import annotations

import runpy
from pathlib import Path

from clusterviz.composite import ALGORITHMS

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_what_its_generator_makes() -> None:
    made = runpy.run_path(str(DOCS / "make_compositing.py"))["text"]()
    assert (DOCS / "concepts/compositing.md").read_text(encoding="utf-8") == made, "run python docs/make_compositing.py"


def test_every_manual_says_all_that_a_reader_needs() -> None:
    page = (DOCS / "concepts/compositing.md").read_text(encoding="utf-8")
    for name in ALGORITHMS:
        manual = page.partition(f"## `{name}`\n")[2].partition("\n## ")[0]
        for item in ("What", "When", "When not", "Cost", "Limits"):
            assert f"- **{item}**" in manual, f"{name}: {item}"
        assert "partial image" in manual, f"{name} does not say how many partial images a rank may have"
