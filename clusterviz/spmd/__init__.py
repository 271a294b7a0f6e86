"""Compiler of the GLSL subset of `shaders/` for CPUs: one invocation a vector lane.

- tokens.py    words and signs of an assembled shader, after macros; places in files
- types.py     types, conversions, and the built-in functions' signatures
- ir.py        typed program
- parser.py    syntax
- checker.py   names and types: from syntax to the typed program
"""
