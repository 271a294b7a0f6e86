"""The CPU as the ray caster's device: the shaders, compiled to vector code, and bricks in memory.

- device.py       device of the ray caster
- arrays.py       blocks of the shaders by name, and threads that run machine code on them
- memory.py       bricks in memory, laid out for few fetches
- pieces.py       transfer functions that fit in registers
- prepared.py     variants that are compiled before anyone waits for them
- empty_space.py  how far rays may skip
"""
