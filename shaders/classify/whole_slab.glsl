// Segment of a whole slab.
Segment slab_at(float s) { return segment_at(s); }
