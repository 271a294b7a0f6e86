"""Rendering of one rank's partial images by single-pass ray casting, in OpenGL or on the CPU.

`choice.py` chooses the ray caster. `raycast.py` draws with the shaders that `variant.py` assembles, and keeps bricks in
GPU memory; `cpu/` holds the CPU ray caster. Both return a `RenderResult`.
"""
