"""Compiler of the GLSL subset of `shaders/` for CPUs: one invocation a vector lane.

It compiles the CPU variants of the shaders (`Variant.cpu`) for `render/cpu`:

    source -> tokens -> parser, with checker and types -> typed program (ir) -> analysis
           -> codegen, with expressions and variables -> LLVM instructions (emitter) -> machine_code

The interpreter executes the typed program with NumPy for the debugger (probe), profiling adds counters and clocks to
the code, and the adversary makes of it what wrong drivers may.
"""
