"""The room of the CPU's ray caster: packets of rays in vectors, compiled by LLVM.

    plan -> order -> job ------------> caster -> pixels
         -> kernel -> program -> machine code

- caster.py        one rank's ray caster
- order.py         a draw as a job
- job.py           the job's record
- memory.py        bricks in memory, laid out for few fetches
- mixed_memory.py  the same of several volumes
- mixed_order.py   several volumes as jobs
- kernel.py        what a kernel is made for
- program.py       its code, put together from the rooms below
- machine_code.py  the same, compiled
- width.py         how wide vectors are
- marching/        tiles, rays, and where their slabs are
- fields/          the scalar at a place, and its gradient
- transfer/        what the transfer function gives
- looks/           what samples come to, all in all

Files of the rooms below are the twins of shaders, and named after them.
"""
