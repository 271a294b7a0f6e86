// Records of the transfer function in a uniform block, which a software renderer reads fastest.
layout(std140, binding = 1) uniform RecordsBlock { vec4 record_part[PARTS_IN_BLOCK]; };

vec4 part_of(int segment, int part) { return record_part[PARTS * segment + part]; }
