"""Volumes: samples on a regular grid."""
