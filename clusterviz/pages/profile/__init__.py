"""Profile of a scene: where the time of its pixels and of its shader goes."""
