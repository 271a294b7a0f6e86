"""Migration of bricks between ranks while frames are drawn.

The dynamic distribution plans flights. This package sends and receives their bricks within a time budget, in a wire
format with checksums.
"""
