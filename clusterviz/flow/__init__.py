"""Flow: lines of vector fields, traced over ranks, and what is drawn of them."""

from clusterviz.flow.tracing import Traced, trace

__all__ = ["Traced", "trace"]
