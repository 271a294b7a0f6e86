"""The render room: one rank's partial image, one file a pass.

- choice.py       which ray caster draws
- raycast.py      volumes by single-pass ray casting, in OpenGL
- vectors/        the same on the processor
- coherence/      where rays start, by what those of the last frame hit
- starts.py       the same, as OpenGL is told, and what it tells
- drawn.py        what a ray caster gives
- frame_block.py  the constants of a draw, shared with the shaders
- variant.py      which shader files and constants a plan needs
- storage.py      how a brick lies in GPU memory
- emptiness.py    which groups of cells have nothing to show
- residence.py    bricks in GPU memory
- chunks.py       more bricks than one buffer holds
- projection.py   from merged scalars and sums to colours
"""
