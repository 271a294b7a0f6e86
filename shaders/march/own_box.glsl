// The cells that this draw owns.
ivec3 box_begin = frame.box_begin.xyz, box_end = frame.box_end.xyz, last_cell = frame.cells.xyz - 1;
