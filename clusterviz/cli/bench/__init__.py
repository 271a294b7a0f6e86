"""`clusterviz bench`: one part measured alone, one file each.

- raycast.py    drawing, on one rank
- over.py       the over operator, beside a copy of the same bytes
- composite.py  compositing of given images, on the ranks of an mpirun
- codec.py      what each codec makes of partial images, and on which links it pays
- network.py    the constants of the time model, on the ranks of an mpirun; probes.py: how each is timed

Each prints a line or two, and writes JSON on request: the result, and every option that was used, defaults included.
"""

from __future__ import annotations

import typer

from clusterviz.cli.bench import codec, composite, network, over, raycast

application = typer.Typer(help="Measure one part: drawing, blending, compositing.", no_args_is_help=True)
application.command("raycast")(raycast.command)
application.command("over")(over.command)
application.command("composite")(composite.command)
application.command("network")(network.command)
application.command("codec")(codec.command)
