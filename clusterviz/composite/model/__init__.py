"""Time model of compositing, and the automatic choice of algorithm and transport."""
