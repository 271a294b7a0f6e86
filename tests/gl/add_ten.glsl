#version 430
// Adds 10 to a number of each work group.
layout(local_size_x = 1) in;
layout(std430, binding = 2) buffer NumbersBlock { uint number[]; };

void main() {
    number[gl_WorkGroupID.x] += 10u;
}
