"""Ray caster for CPUs: the shaders, compiled to vector code, and bricks in memory.

- caster.py       ray caster of one rank
- tables.py       uniform blocks and buffers of a draw
- memory.py       bricks in memory, laid out for few fetches
- pieces.py       transfer functions that fit in registers
- prepared.py     variants that are compiled before anyone waits for them
- empty_space.py  how far rays may skip
- width.py        width of vectors
"""
