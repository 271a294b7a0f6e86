"""Composite the images of an mpi4py program that renders by itself: mpirun -n 4 python examples/composite_images.py"""

import numpy as np
from mpi4py import MPI

from clusterviz.composite import Compositor

comm = MPI.COMM_WORLD
image = np.zeros((480, 640, 4), np.float32)  # premultiplied; what this rank drew
image[40 * comm.rank :, :, [comm.rank % 3, 3]] = 0.5
compositor = Compositor(comm, size=(640, 480))  # once; it keeps what lasts from frame to frame
picture, counters = compositor.composite(image, order=range(comm.size))  # rank 0 in front
if comm.rank == 0:
    print(picture.shape, counters.transport, f"{picture[200, 0]}")
compositor.close()
