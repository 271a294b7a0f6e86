// Records of the transfer function in a storage buffer, if they are too many for a uniform block.
layout(std430, binding = 5) readonly buffer RecordsBlock { vec4 record_part[]; };

vec4 part_of(int segment, int part) { return record_part[PARTS * segment + part]; }
