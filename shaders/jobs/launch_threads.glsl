// CPUs: threads take boxes of points from a counter. A work group is some neighbours along x, one a vector lane.
shared uint piece;

void main() {
    ivec3 counts = (launch_grid.xyz + launch_piece.xyz - 1) / launch_piece.xyz;
    int lane = int(gl_LocalInvocationIndex), pieces = counts.x * counts.y * counts.z;
    for (;;) {
        if (gl_LocalInvocationIndex == 0u) piece = atomicAdd(next_piece, 1u);
        barrier();
        int number = int(piece);
        if (number >= pieces) break;
        ivec3 begin = launch_piece.xyz * ivec3(number % counts.x, number / counts.x % counts.y, number / (counts.x * counts.y));
        ivec3 end = min(begin + launch_piece.xyz, launch_grid.xyz);
        for (int z = begin.z; z < end.z; ++z)
            for (int y = begin.y; y < end.y; ++y)
                for (int x = begin.x; x < end.x; x += GROUP_X) {
                    if (x + lane < end.x) kernel(ivec3(x + lane, y, z));
                }
    }
}
