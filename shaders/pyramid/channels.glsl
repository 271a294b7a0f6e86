// Pixels are taken channel by channel.
#define PIXEL float
