// Ambient light, as much everywhere.
float ambient_at(Place place, vec3 beyond) { return material.x; }
