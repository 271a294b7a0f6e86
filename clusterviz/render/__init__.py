"""Rendering of one rank's partial images by single-pass ray casting, in OpenGL or on the CPU.

`caster.py` is the ray caster, which draws with the shaders that `variant.py` assembles. `choice.py` chooses its device:
`opengl.py`, which keeps bricks in GPU memory, or that of `cpu/`; `device.py` says what is asked of a device.
"""
