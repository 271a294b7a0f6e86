#version 430
// Evaluates one function of the shaders at many points: `vec4 probe(vec4)` is the test's, in the slot of that name.
layout(local_size_x = 64) in;
layout(std430, binding = 8) readonly buffer GivenBlock { vec4 given[]; };
layout(std430, binding = 9) writeonly buffer FoundBlock { vec4 found[]; };

#include <DECLARATIONS>
#include <FUNCTIONS>
#include <PROBE>

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < uint(given.length())) found[i] = probe(given[i]);
}
