// The one march loop. It goes from brick to brick; inside a brick, runs of slabs are taken with brick-local float positions.
// `float scalar_at(int brick, vec3 local)` is the variant's: the field at brick-local cell coordinates, NaN where a voxel is invalid.
float scalar_at(int brick, vec3 local);

// Runs are short and summed apart, and runs are added with compensation, so that 10^6 faint slabs add up.
const int LONGEST_RUN = 32;

struct Sum {
    vec4 high; // premultiplied colour and opacity
    vec4 low;  // what rounding has taken from `high` (Kahan)
};

void add(inout Sum sum, vec4 more) {
    precise vec4 term = more - sum.low;
    precise vec4 total = sum.high + term;
    sum.low = (total - sum.high) - term;
    sum.high = total;
}

// How many slabs from here have their midpoints in the brick for certain: at least this one, at most a run.
int run_length(vec3 local, vec3 slab) {
    vec3 ahead = mix(local, vec3(frame.cells.w) - local, greaterThanEqual(slab, vec3(0.0)));
    vec3 slabs = ahead / max(abs(slab), vec3(1e-30));
    float least = min(min(slabs.x, slabs.y), min(slabs.z, float(LONGEST_RUN)));
    return clamp(int(least - 1e-3) + 1, 1, LONGEST_RUN);
}

// One run of equal slabs inside a brick: premultiplied colour and opacity, as if nothing were in front.
vec4 run(int brick, vec3 local, vec3 slab, int slabs, float units) {
    vec4 sum = vec4(0.0);
    for (int k = 0; k < slabs; ++k) {
        float s = scalar_at(brick, local + float(k) * slab);
        if (!(s >= frame.buckets.w)) continue; // fully transparent below, and NaN compares false
        int segment = segment_of(s);
        float beyond = s - segment_line[segment].x;
        float a = opacity_in(segment, beyond);
        if (a == 0.0) continue;
        float opacity = slab_opacity(a, units);
        sum += ((1.0 - sum.a) * opacity) * vec4(colour_in(segment, beyond), 1.0);
    }
    return sum;
}

vec4 march(Ray ray, vec4 before, inout uint samples) {
    Sum sum = Sum(before, vec4(0.0));
    vec3 slab = vec3(ray.slab);
    float residual = frame.optics.y;
    for (int k = first_owned(ray); k < ray.slabs;) {
        if (1.0 - sum.high.a <= residual) break;
        dvec3 position = midpoint(ray, k);
        ivec3 cell = cell_of(position);
        if (!owned(cell)) break;
        ivec3 number = cell / frame.cells.w;
        ivec3 place = number - frame.bricks_begin.xyz;
        int brick = brick_offset[(place.z * frame.bricks_count.y + place.y) * frame.bricks_count.x + place.x];
        vec3 local = vec3(position - dvec3(number * frame.cells.w));
        bool last = k == ray.slabs - 1;
        int slabs = last ? 1 : min(run_length(local, slab), ray.slabs - 1 - k);
        if (brick >= 0) {
            float units = last ? frame.optics.x * ray.last_share : frame.optics.x;
            vec4 more = run(brick, local, slab, slabs, units);
            add(sum, (1.0 - sum.high.a) * more);
            samples += uint(slabs);
        }
        k += slabs;
    }
    return sum.high;
}
