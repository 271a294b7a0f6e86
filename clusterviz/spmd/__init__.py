"""Compiler of the GLSL subset of `shaders/` for CPUs: one invocation a vector lane.

It compiles the CPU variants of the shaders (`Variant.cpu`) of one volume, but not those that read textures. The ray
caster of `render/cpu` does not use it yet.

- tokens.py        words and signs of an assembled shader, after macros; places in files
- types.py         types, conversions, and the built-in functions' signatures
- ir.py            typed program
- parser.py        syntax
- checker.py       names and types: from syntax to the typed program
- emitter.py       LLVM instructions on numbers that are equal for all lanes, and on vectors
- codegen.py       code of the typed program: masks, branches, loops, memory
- built_in.py      built-in functions
- intrinsics.py    functions that CPUs do in their own way
- machine_code.py  machine code for this CPU
"""
