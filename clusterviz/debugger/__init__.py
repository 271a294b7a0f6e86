"""Debugger of shaders: the draw of a scene, stopped for all pixels at once.

The draw is recorded (`render/recording.py`) and executed by the interpreter, or by OpenGL with probes (`spmd/`).

- draws.py    the dispatches of a scene and a rank, and the pixels of their lanes
- watches.py  values of an expression for all pixels: pictures, histograms, differences
- session.py  breakpoints, steps and watches of a stopped draw
- page.py     the session in a terminal
"""
