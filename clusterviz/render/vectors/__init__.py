"""The room of the CPU's ray caster: packets of rays in vectors, compiled by LLVM.

- caster.py     one rank's ray caster
- kernel.py     the code of a variant, and its machine code
- order.py      a draw as a job
- job.py        the job's record
- width.py      how wide vectors are
- tile.py       a tile of the picture
- state.py      what is known of its packets
- clip.py       which slabs clipping planes keep
- memory.py     bricks in memory, laid out for few fetches
- leaps.py      how far rays may leap over what is empty
- rays.py       rays and their slabs
- place.py      where slabs are
- march.py      from run to run
- field.py      the scalar at a place
- tables.py     rows of tables, a lane each
- classify.py   what the transfer function gives
- pieces.py     the same where pieces are few, in registers
- opacity.py    opacities of slabs
- samples.py    the samples of runs
- composite.py  emission and absorption
- preintegrated.py  the same for slabs that are classified between their ends
- ramps.py      what the transfer function gives those
- over.py       how runs of either are put behind others
- projections.py  maximum, minimum, average and sum
"""
