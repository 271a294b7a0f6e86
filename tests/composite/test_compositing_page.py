"""docs/concepts/compositing.md agrees with the manuals and the schedules of the algorithms."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

from clusterviz.composite import ALGORITHMS

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_what_its_generator_makes() -> None:
    made = runpy.run_path(str(DOCS / "make_compositing.py"))["text"]()
    assert (DOCS / "concepts/compositing.md").read_text(encoding="utf-8") == made, "run python docs/make_compositing.py"


def test_every_manual_says_all_that_a_reader_needs() -> None:
    for name, schedule in ALGORITHMS.items():
        manual = sys.modules[schedule.__module__].__doc__ or ""
        for item in ("What", "When", "When not", "Cost", "Limits"):
            assert re.search(rf"^{item}\b", manual, re.MULTILINE), f"{name}: {item}"
        assert "partial image" in manual, f"{name} does not say how many partial images a rank may have"
