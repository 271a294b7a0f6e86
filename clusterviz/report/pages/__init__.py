"""Reports as pages for people: each measures something on a user's scene and writes an HTML file with a JSON beside it.

- scale/      how a scene scales over ranks, and what to expect beyond the machine
- tradeoff/   what each quality setting costs and buys, for one scene
- folder.py   an output folder that appears whole or not at all
- svg.py      charts as elements of a page
"""
