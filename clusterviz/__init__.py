"""clusterviz: distributed volume rendering for scientific data."""
