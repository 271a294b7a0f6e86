// Pixels are taken by four channels at once, which is faster.
#define PIXEL vec4
