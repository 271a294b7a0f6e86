"""Simulation of schedules on up to 65,536 ranks, without MPI: counts, predicted time, drawings.

- simulate.py      simulation of one frame
- loads.py         loads of algorithms with n² transfers, and of schedules for sparse images
- drawing.py       drawing of a schedule
"""
