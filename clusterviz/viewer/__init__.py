"""Interactive viewer: a browser or a notebook steers the camera and the scene, the ranks draw."""
