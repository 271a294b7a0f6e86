"""Scaling report: strong and weak scaling of a scene, and predictions for up to 65,536 ranks."""
