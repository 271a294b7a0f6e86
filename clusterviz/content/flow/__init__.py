"""Flows: vector fields, which become volumes, lines and points."""
