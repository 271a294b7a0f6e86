// Ambient, diffuse and specular light (Phong), on both sides of a surface, as in VTK. A headlight shines from the eye, as if from afar.
// The rows of `lighting` are those of plan/shading.py.

// Of the ray and in the world: in a loop, a driver may fetch a block's member again each time.
vec3 toward_eye;
mat3 normal_from_gradient = mat3(lighting[3].xyz, lighting[4].xyz, lighting[5].xyz);
vec4 material = lighting[6];

void face(Ray ray) {
    vec3 slab = vec3(ray.slab / max(max(abs(ray.slab.x), abs(ray.slab.y)), max(abs(ray.slab.z), 1e-300LF)));
    toward_eye = -normalize(mat3(lighting[0].xyz, lighting[1].xyz, lighting[2].xyz) * slab);
}

// x^y for x in [0, 1]; 0^0 is 1.
float power(float x, float y) {
    return y == 0.0 ? 1.0 : pow(x, y);
}

// The unit vector from a sample towards a light whose rows begin at `row`; `strength` becomes what arrives of it.
vec3 toward_light(int row, Place place, vec3 beyond, inout vec3 strength);

vec3 lit(vec3 colour, vec3 gradient, Place place, vec3 beyond) {
    vec3 normal = normal_from_gradient * gradient;
    // Scaled first: the square of a steep gradient would leave float32.
    float largest = max(max(abs(normal.x), abs(normal.y)), abs(normal.z));
    bool has_normal = largest > 0.0;
    normal /= has_normal ? largest : 1.0;
    normal /= has_normal ? sqrt(dot(normal, normal)) : 1.0;
    float toward = dot(normal, toward_eye);
    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    for (int k = 0; k < LIGHTS; ++k) {
        int row = 7 + LIGHT_ROWS * k;
        vec3 strength = lighting[row + 1].rgb;
        vec3 light = toward_light(row, place, beyond, strength);
        float facing = dot(normal, light);
        float mirrored = max(2.0 * facing * toward - dot(light, toward_eye), 0.0);
        diffuse += abs(facing) * strength;
        specular += (facing != 0.0 ? power(mirrored, material.w) : 0.0) * strength;
    }
    return min(colour * (material.x + material.y * diffuse) + material.z * specular, 1.0);
}
