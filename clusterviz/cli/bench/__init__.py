"""`clusterviz bench`: benchmarks of single parts.

Each benchmark prints a line or two, and optionally writes a JSON file with the result and all options.
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
