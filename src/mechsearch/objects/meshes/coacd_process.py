"""One convex decomposition in a process of its own: `python coacd_process.py IN.npz OUT.npz`.

CoACD (Wei et al., 2022) can crash or run for minutes on a scanned mesh, hence the process. The
file runs as a script and imports nothing of the package, so that it starts quickly.
"""

import sys

import coacd
import numpy as np


def decompose_file(source: str, destination: str) -> None:
    """Read vertices, faces, threshold and most parts; write the points of each part."""
    with np.load(source, allow_pickle=False) as file:
        mesh = coacd.Mesh(file["vertices"], file["faces"])
        threshold, most = float(file["threshold"]), int(file["most"])
    coacd.set_log_level("error")
    parts = coacd.run_coacd(mesh, threshold=threshold, max_convex_hull=most, seed=0)
    points = [np.asarray(vertices, np.float64) for vertices, _ in parts]
    np.savez(
        destination,
        points=np.concatenate(points),
        sizes=np.array([len(part) for part in points]),
        allow_pickle=False,
    )


if __name__ == "__main__":
    decompose_file(sys.argv[1], sys.argv[2])
