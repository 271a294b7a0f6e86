"""Reports as values: statistics, decisions and traces of frames, and descriptions of machines."""
