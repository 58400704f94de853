"""Golden figures for the plugin `laplacian`, from libigl.

Python 3.9 or newer:

    pip install libigl scipy numpy        (made with libigl 2.6.3, scipy 1.17.1, numpy 2.4.6)
    python laplacian.py [FOLDER]          writes laplacian.json beside this file

FOLDER has `decimated-knight.off` and `decimated-knight-selection.dmat` of libigl's tutorial data; without it, the
figures of that model are left as they are in laplacian.json. No part of the model gets into the file: only where some of
its vertices go, and a hash that tells whether a reader has the same model.

For each model some regions of vertices are held and moved, each by a rigid motion, and the others are found:

    bi-laplacian   igl.harmonic, k = 2, of the displacements (Voronoi areas)
    robust         the same by hand, with libigl's intrinsic Delaunay cotangents and areas; of closed models
    arap           igl.ARAP, its default energy (spokes and rims), until it no longer changes
"""

import sys
from pathlib import Path

import goldens
import igl
import numpy as np
import scipy.sparse.linalg

HERE = Path(__file__).parent
# Every so many vertices are kept.
EVERY = {"bumpy-plane": 7, "decimated-knight": 5}


def bumpy_plane():
    """A height field over the unit square, by rational arithmetic alone, so that any program makes the same one.

    Points are shifted about within their rows, so that some triangles are blunt.
    """
    n = 24
    points, selection = [], []
    for j in range(n):
        for i in range(n):
            inner = 0 < i < n - 1 and 0 < j < n - 1
            x = (i + (((5 * i + 3 * j) % 7 - 3) / 10 if inner else 0)) / (n - 1)
            y = (j + (((3 * i + 5 * j) % 5 - 2) / 10 if inner else 0)) / (n - 1)
            z = 0.5 * (4 * x * (1 - x)) * (4 * y * (1 - y)) * (y - 0.3)
            points.append((x, y, z))
            middle = abs(i - 14) <= 2 and abs(j - 12) <= 2
            selection.append(0 if not inner else 1 if middle else -1)
    triangles = []
    for j in range(n - 1):
        for i in range(n - 1):
            a, b, c, d = j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i
            triangles += [(a, b, c), (a, c, d)]
    motions = [identity(), turn([1, 2, 0.5], 50, [0.6, 0.5, 0.1], [0.05, -0.1, 0.4])]
    # As the program holds them.
    return np.float32(points).astype(float), np.array(triangles), np.array(selection), motions


def knight(folder):
    lines = (folder / "decimated-knight.off").read_text().split("\n")
    vertices, faces = (int(x) for x in lines[1].split()[:2])
    points = [[float(x) for x in line.split()] for line in lines[2 : 2 + vertices]]
    triangles = [[int(x) for x in line.split()[1:]] for line in lines[2 + vertices : 2 + vertices + faces]]
    selection = [int(x) for x in (folder / "decimated-knight-selection.dmat").read_text().split()[2:]]
    points, selection = np.float32(points).astype(float), np.array(selection)
    middle = [points[selection == h].mean(axis=0) for h in range(3)]
    motions = [
        identity(),
        turn([0, 1, 0], 40, middle[1], [0.1, 0, 0.05]),
        turn([1, 0, 1], -30, middle[2], [0, 0.08, 0]),
    ]
    return points, np.array(triangles), selection, motions


def identity():
    return np.eye(3, 4)


def turn(axis, degrees, pivot, by):
    """A turn about an axis through a point, and a shift: three rows of four."""
    m = goldens.rotation(axis, degrees)
    pivot = np.array(pivot)
    return np.column_stack([m, pivot - m @ pivot + np.array(by)])


def quadratic(l, m, b, d):
    """The displacements of least d' L M^-1 L d, given those at b."""
    q = (l @ scipy.sparse.diags(1 / m.diagonal()) @ l).tocsc()
    free = np.setdiff1d(np.arange(q.shape[0]), b)
    found = np.zeros((q.shape[0], 3))
    found[b] = d
    found[free] = scipy.sparse.linalg.spsolve(q[free][:, free], -q[free][:, b] @ d)
    return found


def arap(points, triangles, b, bc, start):
    data = igl.ARAPData()
    data.max_iter = 200
    igl.arap_precomputation(points, triangles, 3, b.astype(np.int32), data)
    now = start
    for _ in range(500):
        before, now = now, igl.arap_solve(bc, data, now)
        change = np.abs(now - before).max()
        # Its rotations are of single precision.
        if change < 1e-6:
            break
    print("  arap: the last 200 steps moved vertices by", change)
    return now


def figures(name, points, triangles, selection, motions):
    print(name)
    b = np.flatnonzero(selection >= 0)
    bc = np.array([motions[selection[v]] @ np.append(points[v], 1) for v in b])
    d = bc - points[b]
    smooth = igl.harmonic(points, triangles, b, d, 2)
    by_hand = quadratic(igl.cotmatrix(points, triangles), igl.massmatrix(points, triangles, 1), b, d)
    assert np.abs(by_hand - smooth).max() < 1e-6, "the Voronoi areas are not libigl's default"
    # From the start that no handle has moved.
    start = points.copy()
    start[b] = bc
    results = {"bi-laplacian": points + smooth, "arap": arap(points, triangles, b, bc, start)}
    if len(igl.boundary_facets(triangles)[0]) == 0:
        l, lengths, faces = igl.intrinsic_delaunay_cotmatrix(points, triangles)
        results["robust"] = points + quadratic(l, igl.massmatrix_intrinsic(lengths, faces, 1), b, d)
        print("  robust and bi-laplacian differ by", np.abs(results["robust"] - results["bi-laplacian"]).max())
    keep = np.arange(0, len(points), EVERY[name])
    return {
        "vertices": len(points),
        "fingerprint": goldens.fingerprint(points, triangles, selection),
        "diagonal": round(float(np.linalg.norm(np.ptp(points, axis=0))), 7),
        "motions": [m.tolist() for m in motions],
        "every": EVERY[name],
        "positions": {k: [[round(x, 7) for x in p] for p in v[keep].tolist()] for k, v in results.items()},
    }


def main():
    path = HERE / "laplacian.json"
    known = goldens.read(path)
    known["bumpy-plane"] = figures("bumpy-plane", *bumpy_plane())
    if len(sys.argv) > 1:
        known["decimated-knight"] = figures("decimated-knight", *knight(Path(sys.argv[1])))
    goldens.write(path, known)


if __name__ == "__main__":
    main()
