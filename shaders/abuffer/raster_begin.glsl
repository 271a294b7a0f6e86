#version 430
// Moves the vertices to the camera's coordinates, finds the pixels in which they are, as `move` of tile_kernel.py does, and empties the lists.
layout(local_size_x = 64) in;

#include <FRAME>
#include <RASTER>
struct Move {
    dvec4 right, up, forward; // the camera's coordinates of (x, y, z, 1) of the file
    dvec4 unit;               // camera units of a world unit; and 1 for corners of cells, behind which are numbers, no radii
    ivec4 words;              // first vertex, first words of its position and of its radius or −1, 1 if positions are float64
};
layout(std430, binding = 9) readonly buffer MovesBlock { Move moves[]; };
layout(std430, binding = 10) readonly buffer WordsBlock { uint word[]; };
layout(std430, binding = 12) writeonly buffer VerticesBlock { vec4 vertex[]; };
layout(std430, binding = 18) writeonly buffer BoxesBlock { vec4 box[]; }; // least and greatest column, least and greatest row
layout(std430, binding = 11) writeonly buffer FragmentsBlock { uint fragment_list[]; };
layout(std430, binding = 25) writeonly buffer OpaqueBlock { uint nearest_opaque[]; };
const double ROUNDED = 1e-6LF, MARGIN = 1e-2LF; // as in tile_kernel.py
const float BEYOND = 3e38;

dvec3 position_of(Move own, int number) {
    int at = own.words.y + 3 * number * (own.words.w + 1);
    if (own.words.w == 0) return dvec3(uintBitsToFloat(word[at]), uintBitsToFloat(word[at + 1]), uintBitsToFloat(word[at + 2]));
    double x = packDouble2x32(uvec2(word[at], word[at + 1])), y = packDouble2x32(uvec2(word[at + 2], word[at + 3]));
    return dvec3(x, y, packDouble2x32(uvec2(word[at + 4], word[at + 5])));
}

float moved(dvec4 axis, dvec3 from) {
    precise double found = axis.x * from.x + axis.y * from.y + axis.z * from.z + axis.w;
    return float(found);
}

double below(double number) { return number - MARGIN - ROUNDED * abs(number); }

// As walks may begin behind the eye, corners of cells there have the pixels of the line through the eye.
vec4 box_of(vec4 at, bool of_cell) {
    double x = double(at.x) - raster.eye.y, y = raster.eye.z - double(at.y), z = double(at.z) - raster.eye.x, r = of_cell ? 0.0LF : double(at.w);
    double size = ROUNDED * (abs(double(at.x)) + abs(double(at.y)) + abs(double(at.z)) * (1.0LF + raster.centre.w) + r);
    double near = 1.0LF, far = 1.0LF, e = r + size;
    if (raster.centre.z != 0.0LF) {
        near = z - r;
        far = z + r;
        if (of_cell && far < -size) {
            x = -x;
            y = -y;
            near = far = -z;
        }
        if (near <= size) return far < 0.0LF ? vec4(-BEYOND, BEYOND, BEYOND, -BEYOND) : vec4(-BEYOND, BEYOND, -BEYOND, BEYOND);
    }
    near = raster.eye.w / near;
    far = raster.eye.w / far;
    dvec2 low = dvec2((x - e) * (x < e ? near : far), (y - e) * (y < e ? near : far)) + raster.centre.xy;
    dvec2 high = dvec2((x + e) * (x < -e ? far : near), (y + e) * (y < -e ? far : near)) + raster.centre.xy;
    dvec4 found = dvec4(below(low.x), -below(-high.x), below(low.y), -below(-high.y));
    return vec4(clamp(found, dvec4(-1e30LF), dvec4(1e30LF)));
}

int move_of(int number) {
    int low = 0, high = raster.counts.z;
    while (high - low > 1) {
        int middle = (low + high) >> 1;
        if (number >= moves[middle].words.x) low = middle;
        else high = middle;
    }
    return low;
}

void main() {
    int number = invocation();
    if (number < raster.counts.y) fragment_list[number] = number == 0 ? uint(raster.counts.w) : 0u;
    if (number < frame.rect.z * frame.rect.w) nearest_opaque[number] = 0xffffffffu;
    if (number >= raster.counts.x) return;
    Move own = moves[move_of(number)];
    int inside = number - own.words.x;
    dvec3 from = position_of(own, inside);
    float radius = own.words.z < 0 ? 0.0 : float(double(uintBitsToFloat(word[own.words.z + inside])) * own.unit.x);
    vec4 at = vec4(moved(own.right, from), moved(own.up, from), moved(own.forward, from), radius);
    vertex[number] = at;
    box[number] = box_of(at, own.unit.y != 0.0LF);
}
