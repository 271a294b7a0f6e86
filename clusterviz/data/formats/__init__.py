"""Data formats, one module each; its `open_<format>` reads the header and returns a source."""
