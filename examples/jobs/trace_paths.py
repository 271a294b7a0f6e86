"""Path tracing of a scene's volume, with light that is scattered many times.

    mpirun -n 4 python examples/jobs/trace_paths.py examples/head.yaml -D volumes.0.path=head.nii.gz -o traced.png

The picture and its standard error are printed and written after each pass, so that it may be ended at any time. Without
scattering (--scattering 0) it becomes that of `clusterviz render`. The light is a uniform environment, and the
directional light of the scene, if it has one.
"""

from __future__ import annotations

import argparse

import numpy as np
from path_tracing import PathTracing, trace_paths

from clusterviz import jobs, load_scene
from clusterviz.comm import agree
from clusterviz.errors import ClustervizError


def main() -> None:
    default = PathTracing()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help="a scene file with one volume")
    parser.add_argument("-D", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("-o", "--output", default="traced.png", help="picture: .png, .npy or .exr")
    parser.add_argument("--samples", type=int, default=default.samples, help="paths of a pixel")
    parser.add_argument("--scattering", type=float, default=default.scattering, help="share of the extinction, 0 to 1")
    parser.add_argument("--anisotropy", type=float, default=default.anisotropy, help="mean cosine, -0.99 to 0.99")
    parser.add_argument("--environment", type=float, nargs=3, default=default.environment, metavar=("R", "G", "B"))
    parser.add_argument("--voxels", choices=("auto", "replica", "blocks"), default=default.voxels)
    given = parser.parse_args()
    try:
        with jobs.cluster() as cluster:
            with agree(cluster.channel, None, "settings"):
                scene = load_scene(given.scene, given.overrides)
                settings = PathTracing(
                    samples=given.samples,
                    scattering=given.scattering,
                    anisotropy=given.anisotropy,
                    environment=tuple(given.environment),
                    voxels=given.voxels,
                )
            for picture in trace_paths(cluster, scene, settings):
                if picture is None:  # not on rank 0
                    continue
                error = np.sqrt(np.mean(picture.standard_error[..., :3] ** 2))
                print(f"{picture.samples} samples, standard error {error:.4f}, voxels: {picture.voxels}", flush=True)
                picture.image.save(given.output)
    except ClustervizError as error:
        parser.exit(error.exit_status, f"{parser.prog}: {error}\n")


if __name__ == "__main__":
    main()
