// GPUs: a work group is a tile, one invocation a pixel.
void main() {
    int lane = int(gl_LocalInvocationIndex), tile = int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x);
    ivec2 pixel = LIST_TILE * ivec2(gl_WorkGroupID.xy) + ivec2(lane % LIST_TILE, lane / LIST_TILE);
    if (all(lessThan(pixel, frame.rect.zw))) find_all(pixel, tile);
}
