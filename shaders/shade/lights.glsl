// Light of surfaces and lines. A headlight is a directional light along the view.
// The rows of `lighting` are those of plan/shading.py.

// Of the ray and in the world: in a loop, a driver may fetch a block's member again each time.
vec3 toward_eye;
mat3 normal_from_gradient = mat3(lighting[3].xyz, lighting[4].xyz, lighting[5].xyz);
vec4 material = lighting[6];

void face(Ray ray) {
    Real longest = larger(larger(magnitude(ray.slab.x), magnitude(ray.slab.y)), larger(magnitude(ray.slab.z), TINY));
    vec3 slab = to_float(quotient(ray.slab, longest));
    toward_eye = -normalize(mat3(lighting[0].xyz, lighting[1].xyz, lighting[2].xyz) * slab);
}

// x^y for x in [0, 1]; 0^0 is 1.
float power(float x, float y) { return y == 0.0 ? 1.0 : pow(x, y); }

// Unit vector from a sample towards a light whose rows begin at `row`; `strength` becomes the light that arrives.
vec3 toward_light(int row, Place place, vec3 beyond, inout vec3 strength);

// Share of the ambient light that a sample reflects.
float ambient_at(Place place, vec3 beyond);

// Shares of a light that a surface with a normal, or a line with a direction, reflects to the eye: diffuse and specular.
vec2 reflected(vec3 normal, vec3 light);

// Premultiplied colour under the lights. `capped`: the normal of a cut face is blended in, with a weight that falls with the depth behind the face and with the gradient.
vec4 lit(vec4 colour, vec3 gradient, Place place, vec3 beyond, bool capped) {
    vec3 normal = normal_from_gradient * gradient;
    // Scaled first, as the square of a steep gradient would overflow float32; by no more than has a normal reciprocal.
    float largest = max(max(abs(normal.x), abs(normal.y)), abs(normal.z)), scale = clamp(largest, 1e-37, 1e37);
    normal *= 1.0 / scale;
    float length = largest > 0.0 ? sqrt(dot(normal, normal)) : 1.0;
    normal *= 1.0 / length;
    // lighting[3].w is the least factor of gradients.
    float steep = scale * length, share = 0.0;
    vec3 cap = vec3(0.0);
    for (int k = 0; capped && steep * lighting[3].w < 1.0 && k < CAPS; ++k) {
        int row = 7 + LIGHT_ROWS * LIGHTS + 2 * k;
        vec4 face = lighting[row], plane = lighting[row + 1];
        float behind = dot(plane.xyz, FROM_LEVEL * (vec3(brick_begin + place.cell) + beyond)) + plane.w;
        float found = (1.0 - steep * face.w) * clamp(1.0 - behind, 0.0, 1.0);
        if (found > share) {
            share = found;
            cap = face.xyz;
        }
    }
    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    for (int k = 0; k < LIGHTS; ++k) {
        int row = 7 + LIGHT_ROWS * k;
        vec3 strength = lighting[row + 1].rgb;
        vec3 light = toward_light(row, place, beyond, strength);
        vec2 shares = reflected(normal, light);
        if (share > 0.0) shares = mix(shares, reflected(cap, light), share);
        diffuse += shares.x * strength;
        specular += shares.y * strength;
    }
    return vec4(min(colour.rgb * (ambient_at(place, beyond) + material.y * diffuse) + colour.a * material.z * specular, colour.a), colour.a);
}
