// Gradient magnitude in world units. The rows of `grading` are those of plan/grading.py.
mat3 world_from_gradient = mat3(grading[0].xyz, grading[1].xyz, grading[2].xyz);

float magnitude_of(vec3 gradient) {
    vec3 world = world_from_gradient * gradient;
    if (!all(are_numbers(vec4(world, 0.0)))) return 3e38;
    // Scaled first: the square of a steep gradient would leave float32.
    float largest = max(max(abs(world.x), abs(world.y)), abs(world.z));
    world /= largest > 0.0 ? largest : 1.0;
    return largest * sqrt(dot(world, world));
}
