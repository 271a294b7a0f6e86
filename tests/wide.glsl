#version 430
layout(local_size_x = 16, local_size_y = 16) in;
layout(std430, binding = 0) buffer B0 { float b0[]; };
layout(std430, binding = 1) buffer B1 { float b1[]; };
layout(std430, binding = 2) buffer B2 { float b2[]; };
layout(std430, binding = 3) buffer B3 { float b3[]; };
layout(std430, binding = 4) buffer B4 { float b4[]; };
layout(std430, binding = 5) buffer B5 { float b5[]; };
layout(std430, binding = 6) buffer B6 { float b6[]; };
layout(std430, binding = 7) buffer B7 { float b7[]; };
layout(std430, binding = 8) buffer B8 { float b8[]; };
layout(std430, binding = 9) buffer B9 { float b9[]; };

double half_of(double x) {
    return 0.5 * x;
}

void main() {
    b0[0] = float(half_of(double(b0[1])));
    b1[0] = float(half_of(double(b1[1])));
    b2[0] = float(half_of(double(b2[1])));
    b3[0] = float(half_of(double(b3[1])));
    b4[0] = float(half_of(double(b4[1])));
    b5[0] = float(half_of(double(b5[1])));
    b6[0] = float(half_of(double(b6[1])));
    b7[0] = float(half_of(double(b7[1])));
    b8[0] = float(half_of(double(b8[1])));
}
