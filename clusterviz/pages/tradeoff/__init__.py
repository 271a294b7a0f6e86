"""Tradeoff report: time and error of every quality setting of a scene, and their Pareto front."""
