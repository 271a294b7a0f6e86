// One invocation a pixel. A dispatch may end before its rays do; the next one continues.

bool has_done_share(int iterations, int k) { return float(iterations) >= frame.optics.w; }
int first_plane() { return frame.rect.z * frame.rect.w + int(gl_NumWorkGroups.x * gl_NumWorkGroups.y); }

const int NEVER = 0x7fffffff, ABSENT = -3; // of bricks: their voxels are not on the device yet
int noted_brick = -1; // brick

// A ray ends its share of a dispatch in front of a brick that is absent; the host stores the bricks that are noted, and goes on.
bool is_awaited(int brick) {
    if (frame.notes.z >= 0 && noted_brick != brick_found) {
        noted_brick = brick_found;
        progress[frame.notes.z + noted_brick] = 1;
    }
    return brick == ABSENT;
}

// Dispatches are queued: where rays have to go on in an earlier box, those behind it wait for another turn.
bool waits_for_box_in_front() { return frame.notes.y >= 0 && progress[frame.notes.y] != 0; }

void note_unfinished() {
    unfinished = 1u;
    if (frame.notes.x >= 0) progress[frame.notes.x] = 1;
}

shared uint samples_of_group;

void main() {
    if (waits_for_box_in_front()) {
        note_unfinished();
        return;
    }
    if (gl_LocalInvocationIndex == 0u) samples_of_group = 0u;
    barrier();
    // Neighbours in a SIMD unit are blocks of 4 x 2 pixels rather than rows, as their rays are more similar.
    int lane = int(gl_LocalInvocationIndex);
    ivec2 inside = 8 * ivec2(gl_WorkGroupID.xy) + ivec2((lane & 3) + (lane >> 3 & 1) * 4, (lane >> 2 & 1) + (lane >> 4) * 2);
    if (all(lessThan(inside, frame.rect.zw)) && is_drawn_now(int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x))) {
        int pixel = inside.y * frame.rect.z + inside.x, lost = frame.rect.z * frame.rect.w + pixel;
        uint samples = 0u;
        Ray ray = ray_through(inside + frame.rect.xy);
        cut(ray, WHOLE_SLABS);
        face(ray);
        set_thickness(ray.thickness);
        bool begins = frame.first_dispatch != 0;
        Sum sum = Sum(vec4(0.0), vec4(0.0));
        if (!begins || frame.first_box == 0) sum = Sum(pixels[pixel], pixels[lost]);
        int slab = begins ? first_slab(ray) : progress[pixel];
        start_at(ray, pixel, begins, slab);
        if (begins) count_ray(pixel, ray, slab);
        begin_share(pixel);
        go_on(ray, sum, slab, samples);
        end_share();
        end_at(ray, pixel, sum, slab);
        pixels[pixel] = sum.high;
        // The rounding error of finished rays matters only if another box adds to them.
        if (slab < ray.slabs || frame.first_box != 2) pixels[lost] = sum.low;
        progress[pixel] = slab < ray.slabs ? slab : NEVER;
        if (slab < ray.slabs) note_unfinished();
        atomicAdd(samples_of_group, samples);
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u)
        progress[frame.rect.z * frame.rect.w + int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x)] += int(samples_of_group);
}
