"""Flow: lines of vector fields, traced over ranks, and what is drawn of them."""
