"""The render room: one rank's partial image, one file a pass.

- raycast.py      volumes by single-pass ray casting
- frame_block.py  the constants of a draw, shared with the shaders
- storage.py      how a brick lies in GPU memory
- residence.py    bricks in GPU memory
- chunks.py       more bricks than one buffer holds
"""
