"""Automatic settings: the mode by a cost probe and a time model, and the quality by an error bound.

Small pictures of the scene are drawn first. All ranks use the same results, so all choose the same settings.
"""
