// Least and greatest voxel of a cell, as stored; false if one is invalid.
bool extremes_at(int brick, ivec3 place, out float low, out float high) {
    vec4 near, far;
    cell_at(brick, place, ivec3(0), near, far);
    vec4 least = min(near, far), most = max(near, far);
    low = min(min(least.x, least.y), min(least.z, least.w));
    high = max(max(most.x, most.y), max(most.z, most.w));
    // By their bits, since compilers invert comparisons, which is wrong for NaN.
    uvec4 bits = max(floatBitsToUint(abs(near)), floatBitsToUint(abs(far)));
    return !MAY_BE_INVALID || all(lessThan(bits, uvec4(0x7f800000u)));
}
