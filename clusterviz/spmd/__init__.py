"""Compiler of the GLSL subset of `shaders/` for CPUs: one invocation a vector lane.

It compiles the CPU variants of the shaders (`Variant.cpu`) for `render/cpu`.

- source.py        assembled shader
- tokens.py        words and signs of an assembled shader, after macros; places in files
- types.py         types, conversions, and the built-in functions' signatures
- ir.py            typed program
- parser.py        syntax
- checker.py       names and types: from syntax to the typed program
- emitter.py       LLVM instructions on numbers that are equal for all lanes, and on vectors
- analysis.py      costs, effects, and how statements are left
- variables.py     masks of active lanes, variables, blocks and arrays in memory
- expressions.py   code of expressions
- codegen.py       code of statements and calls
- built_in.py      built-in functions
- intrinsics.py    functions that CPUs do in their own way
- look.py          looks of users: checked, and made safe
- machine_code.py  machine code for this CPU
- profiling.py     the same code with counters and clocks
- interpreter.py   the typed program with NumPy, stopped before every statement
- probe.py         values at a place in a shader, by the interpreter or written by an instrumented shader
"""
