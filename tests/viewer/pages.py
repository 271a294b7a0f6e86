"""Waiting in pages of the live view."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Page


def wait_until(page: Page, expression: str, seconds: float = 30.0) -> Any:
    """Return an expression's value once it is true; Playwright's own waiting needs eval, which the page forbids."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := page.evaluate(expression):
            return value
        page.wait_for_timeout(10)
    raise TimeoutError(f"after {seconds:g} s not yet: {expression}")
