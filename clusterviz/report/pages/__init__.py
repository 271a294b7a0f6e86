"""Report pages: measurements of a scene as an HTML page with a JSON file beside it."""
