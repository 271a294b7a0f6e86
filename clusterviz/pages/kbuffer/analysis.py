"""Entries of the k-buffer that pixels need, and comparisons that it takes.

Faces are drawn in the order of their centroids' depths. A k-buffer holds k fragments of a pixel; with each new one it
takes the nearest of k + 1 out, whose segment ends at the second nearest. So a picture is right if no fragment arrives
behind more than k − 1 others that are farther away, or behind k where nothing was taken out yet: a pixel needs one
entry more than the most places by which one of its fragments is late (as many if it is nearer than all before), and 2
at least.

Of a pixel with s fragments, the unsorted buffer takes 2k − 1 comparisons with each fragment beyond the first k, and
2l − 3 to take one out of l that are left; the sorted one compares each new fragment with all that it holds. So

    unsorted  (2k − 1)(s − k) + (k − 1)²        sorted  k (s − k) + k (k − 1) / 2        for s ≥ k,

and (s − 1)² and s (s − 1) / 2 for s < k. The share of comparisons saved tends to (k − 1) / (2k − 1) for long lists.

References
----------
S. P. Callahan, M. Ikits, J. L. D. Comba, C. T. Silva: Hardware-assisted visibility sorting for unstructured volume
rendering, IEEE TVCG 11(3), 2005, section 5.2.
J. Hu, W. Wang, Q. Ma, S. Li: Optimization and implementation of unstructured grid volume rendering algorithm, sections
II and III. (Their share saved tends to 1/2, as it counts 2k − 2 comparisons where their sum counts 2k − 1.)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.kernels.radix_sort import sorted_order
from clusterviz.scene.camera import camera_axes, camera_vectors
from clusterviz.scene.values import Camera

Indices = NDArray[np.int64]
_SOURCES = [Path(__file__).with_name("fragment_kernel.py")]
_LIST = CompiledKernel(
    "clusterviz.pages.kbuffer.fragment_kernel",
    "list_fragments",
    "float64[:,::1]; float64[::1]; uint32[::1]; uint32[:,::1]; int64[:,::1]; float64[::1]",
    _SOURCES,
)
_ENTRIES = CompiledKernel(
    "clusterviz.pages.kbuffer.fragment_kernel",
    "count_entries",
    "int64[::1]; float64[::1]; int32[::1]",
    _SOURCES,
)


@dataclass(frozen=True, eq=False)
class KBufferNeeds:
    """Fragments of one view."""

    fragments: Indices  # int64 (h, w), number in each pixel
    needed: Indices  # int64 (h, w), entries that make the pixel right; 0 without fragments

    def wrong(self, k: int) -> int:
        """Return the number of pixels that a buffer of k entries may get wrong."""
        return int((self.needed > k).sum())


def analyse(
    points: NDArray[np.floating], faces: NDArray[np.uint32], camera: Camera, size: tuple[int, int], threads: int = 1
) -> KBufferNeeds:
    """Return what the pixels of a view need.

    Parameters
    ----------
    points : (n, 3), world
    faces : uint32 (f, 3), corners
    camera : completed
    size : (width, height) in pixels

    Raises
    ------
    InputError
        A point is not in front of the eye.
    """
    position, focal_point, view_up = camera_vectors(camera)
    axes = np.stack(camera_axes(position, focal_point, view_up))
    vertices = np.ascontiguousarray((points.astype(np.float64) - position) @ axes.T)
    is_perspective = camera.parallel_scale is None
    if is_perspective and not (vertices[:, 2] > 0).all():
        raise InputError("a point of the grid is beside or behind the eye", where="camera: position", found=position)
    half = np.tan(np.radians(camera.view_angle) / 2) if camera.parallel_scale is None else camera.parallel_scale
    lens = np.array([2 * half / size[1], float(is_perspective)])
    order = sorted_order(vertices[:, 2][faces].mean(axis=1).astype(np.float32), threads)
    counts = np.zeros((size[1], size[0]), np.int64)
    _LIST(vertices, lens, order, faces, counts, np.zeros(0))
    begins = np.append(0, np.cumsum(counts))
    depths, needed = np.zeros(max(1, int(begins[-1]))), np.zeros(counts.size, np.int32)
    _LIST(vertices, lens, order, faces, begins[:-1].reshape(counts.shape).copy(), depths)
    _ENTRIES(begins, depths, needed)
    return KBufferNeeds(counts, needed.reshape(counts.shape).astype(np.int64))


def comparisons(fragments: Indices, k: int, is_sorted: bool) -> Indices:
    """Return the comparisons of pixels with some numbers of fragments, of the unsorted or the sorted k-buffer."""
    held = np.minimum(fragments, k)
    beyond = fragments - held
    found: Indices = k * beyond + held * (held - 1) // 2
    if not is_sorted:
        found = (2 * k - 1) * beyond + np.maximum(held - 1, 0) ** 2
    return found
