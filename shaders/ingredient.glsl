// One volume of a mixture. It is put in once for each volume, after the files that sample it; what belongs to one volume are macros then, and
// face_before, begin_before and take_before are the same for the volumes put in before, or nothing.
ivec2 seen;  // the slabs of the ray whose midpoints lie in the volume, decided for the whole ray: every box finds the same ones
Place here;  // where the run's first slab is in the volume's own brick
vec3 stride; // from one midpoint to the next, in voxels

dvec3 in_volume(dvec3 position) {
    return dvec3(dot(frame.x.xyz, position) + frame.x.w, dot(frame.y.xyz, position) + frame.y.w, dot(frame.z.xyz, position) + frame.z.w);
}

void see(Ray ray, dvec4 low_side, double extent) {
    // Wider than the volume by what rounding cannot exceed: a ray along a face sees it from everywhere.
    double slack = 1e-9LF * extent;
    ivec2 above = kept_slabs(ray, low_side + dvec4(0.0LF, 0.0LF, 0.0LF, slack));
    ivec2 below = kept_slabs(ray, dvec4(0.0LF, 0.0LF, 0.0LF, extent + slack) - low_side);
    seen = ivec2(max(seen.x, max(above.x, below.x)), min(seen.y, min(above.y, below.y)));
}

void face_all(Ray ray) {
    face_before(ray);
    Ray own = ray;
    own.slab = dvec3(dot(frame.x.xyz, ray.slab), dot(frame.y.xyz, ray.slab), dot(frame.z.xyz, ray.slab));
    face(own);
    stride = vec3(own.slab);
    seen = ivec2(0, ray.slabs);
    see(ray, frame.x, frame.last.x);
    see(ray, frame.y, frame.last.y);
    see(ray, frame.z, frame.last.z);
}

void begin_all(dvec3 position, int brick) {
    begin_before(position, brick);
    int part = brick + 4 * NUMBER, begin = int(voxels[part]);
    dvec3 at = in_volume(position);
    ivec3 cell = ivec3(floor(at));
    brick_begin = ivec3(voxels[part + 1], voxels[part + 2], voxels[part + 3]);
    here = Place(begin < 0 ? GAP : brick + begin, cell - brick_begin, vec3(at - dvec3(cell)), 0);
}

void take_all(inout vec4 sum, int k, int at) {
    take_before(sum, k, at);
    if (here.brick < 0 || k < seen.x || k >= seen.y) return;
    vec3 beyond = here.beyond + float(at) * stride;
    sum += depth_of(scalar_at(here.brick, here.cell, beyond), here, beyond);
}
