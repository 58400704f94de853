"""Radial basis functions for the tests of plugins/rbf: writes rbf.json beside itself.

    pip install numpy scipy          (made with scipy 1.17.1, numpy 2.4.6)
    python rbf.py

Points about a bent tube; those at one end are fixed, two handles turn, grow and shift. The displacements of these are
interpolated exactly, and found at the other points:

    triharmonic    SciPy's RBFInterpolator, kernel `cubic`, degree 1: r³ and an affine part, as in the plugin
    biharmonic     kernel `linear`, degree 1; SciPy's default is 0, but displacements of turns and scales are affine, and an
                   affine part reproduces them
    degree-0       the same with degree 0, to show that it differs
    compact-c2     Wendland's kernels, by hand, as SciPy has none: no affine part, so that what is far away stays
    compact-c4
"""

import json
from pathlib import Path

import goldens
import numpy as np
from scipy.interpolate import RBFInterpolator

SUPPORT = 0.4


def points():
    k = np.arange(260)
    t = (k + 0.5) / 260
    angle = k * np.pi * (3 - 5**0.5)
    radius = 0.2 + 0.05 * np.sin(7 * t)
    p = np.stack([radius * np.cos(angle) + 0.4 * t**2, 2 * t, radius * np.sin(angle) - 0.2 * t], axis=1)
    return np.float32(p).astype(float)


def motion(axis, degrees, scale, pivot, by):
    """A turn and a scale about a point, and a shift: three rows of four."""
    m = scale * goldens.rotation(axis, degrees)
    return np.column_stack([m, pivot - m @ np.array(pivot) + by])


def wendland(at, centers, values, support, phi):
    def matrix(a):
        t = np.linalg.norm(a[:, None] - centers[None], axis=2) / support
        return np.where(t < 1, phi(t), 0)

    return matrix(at) @ np.linalg.solve(matrix(centers), values)


def main():
    p = points()
    selection = np.full(len(p), -1)
    selection[p[:, 1] < 0.3] = 0
    selection[(p[:, 1] > 0.9) & (p[:, 1] < 1.1)] = 1
    selection[p[:, 1] > 1.75] = 2
    motions = [
        motion([1, 2, 0.5], 35, 1.3, [0.1, 1, -0.1], np.array([0.1, 0, 0.05])),
        motion([0, 0, 1], -60, 0.8, [0.4, 1.9, -0.2], np.array([0.3, -0.1, 0])),
    ]
    held = selection >= 0
    values = np.zeros((len(p), 3))
    for i, m in enumerate(motions):
        inside = selection == i + 1
        values[inside] = p[inside] @ m[:, :3].T + m[:, 3] - p[inside]
    c, d, at = p[held], values[held], p[~held]
    diagonal = float(np.linalg.norm(np.ptp(p, axis=0)))
    support = SUPPORT * diagonal
    results = {
        "triharmonic": RBFInterpolator(c, d, kernel="cubic", degree=1)(at),
        "biharmonic": RBFInterpolator(c, d, kernel="linear", degree=1)(at),
        "degree-0": RBFInterpolator(c, d, kernel="linear", degree=0)(at),
        "compact-c2": wendland(at, c, d, support, lambda t: (1 - t) ** 4 * (4 * t + 1)),
        "compact-c4": wendland(at, c, d, support, lambda t: (1 - t) ** 6 * (35 * t**2 + 18 * t + 3) / 3),
    }
    lines = lambda rows: [[round(x, 9) for x in row] for row in rows.tolist()]
    golden = {
        "points": lines(p),
        "selection": selection.tolist(),
        "motions": [m.tolist() for m in motions],
        "support": SUPPORT,
        "displacements": {k: lines(v) for k, v in results.items()},
    }
    rows = [f" {json.dumps(k)}: {json.dumps(v)}" for k, v in golden.items()]
    (Path(__file__).parent / "rbf.json").write_text("{\n" + ",\n".join(rows) + "\n}\n")
    print(held.sum(), "constraints,", len(at), "other points")


main()
