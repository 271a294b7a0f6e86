"""Simulation of schedules on up to 65,536 ranks, without MPI: counts, predicted time, drawings."""
