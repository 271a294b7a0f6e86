from gl.probing import context, probe, shaders, shared_context

__all__ = ["context", "probe", "shaders", "shared_context"]
