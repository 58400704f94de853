"""Golden figures for the plugin `skinning`.

Python 3.9 or newer:

    pip install libigl numpy scipy        (made with libigl 2.6.3, numpy 2.4.6)
    python skinning.py [FOLDER]           writes skinning.json beside this file

FOLDER has `arm.obj`, `arm-weights.dmat` and `arm.tgf` of libigl's tutorial data; without it, the figures of that model are
left as they are in skinning.json. No part of the model gets into the file: only where some of its vertices go, and a hash that
tells whether a reader has the same model.

    linear            igl.lbs_matrix
    dual-quaternion   L. Kavan, S. Collins, J. Zara, C. O'Sullivan, ACM TOG 27, 2008, algorithm 1 (libigl's `dqs` is not in its
                      Python binding), with the signs of quaternions as against that of the largest weight, as there
"""

import sys
from pathlib import Path

import goldens
import igl
import numpy as np

HERE = Path(__file__).parent
# Every so many vertices are kept.
EVERY = {"tube": 11, "arm": 61}


def tube():
    """A tube along x, by rational arithmetic alone, so that any program makes the same one, with a chain in it."""
    points, weights = [], []
    for i in range(31):
        for k in range(12):
            x, t = i / 30, (k - 5.5) / 3
            y, z = (1 - t * t) / (1 + t * t) / 8, 2 * t / (1 + t * t) / 8
            points.append((x, y, z))
            weights.append([1 / (0.05 + (x - middle) ** 2) ** 2 for middle in (0.2, 0.55, 0.85)])
    joints = np.array([(0, 0, 0), (0.4, 0, 0), (0.7, 0, 0)])
    weights = np.array(weights)
    turns = [([0, 0, 1], 15), ([1, 0.2, -0.5], 80), ([0.3, 1, 0], -65)]
    # As the program holds them.
    points = np.float32(points).astype(float)
    return points, weights / weights.sum(axis=1, keepdims=True), joints, turns


def arm(folder):
    lines = (folder / "arm.obj").read_text().split("\n")
    points = np.float32([[float(x) for x in l.split()[1:4]] for l in lines if l.startswith("v ")]).astype(float)
    numbers = (folder / "arm-weights.dmat").read_text().split()
    bones, count = int(numbers[0]), int(numbers[1])
    weights = np.array([float(x) for x in numbers[2:]]).reshape(bones, count).T
    tgf = (folder / "arm.tgf").read_text().split("#")[0]
    joints = np.array([[float(x) for x in l.split()[1:4]] for l in tgf.split("\n") if l.strip()])
    turns = [([0, 0, 1], 10), ([0, 1, 1], -40), ([1, 0.3, 0], 75), ([0, 0.2, 1], 60)]
    return points, weights / weights.sum(axis=1, keepdims=True), joints[:bones], turns


def chain(joints, turns):
    """Each joint's motion, with that of the one before: three rows of four."""
    motions, above = [], np.eye(4)
    for at, (axis, degrees) in zip(joints, turns):
        own = np.eye(4)
        own[:3, :3] = goldens.rotation(axis, degrees)
        own[:3, 3] = at - own[:3, :3] @ at
        above = above @ own
        motions.append(above[:3])
    return motions


def linear(points, weights, motions):
    return igl.lbs_matrix(points, weights) @ np.concatenate([m.T for m in motions])


def quaternion(m):
    """Scalar first; the largest of the four is found first."""
    squares = np.array([1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
                        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2]])
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    rows = [[squares[0], a, b, c], [a, squares[1], d, e], [b, d, squares[2], f], [c, e, f, squares[3]]]
    row = np.array(rows[int(squares.argmax())])
    return row / np.linalg.norm(row)


def product(p, q):
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def dual_quaternion(points, weights, motions):
    real = np.array([quaternion(m[:, :3]) for m in motions])
    dual = np.array([0.5 * product(np.concatenate([[0], m[:, 3]]), r) for m, r in zip(motions, real)])
    found = []
    for p, w in zip(points, weights):
        signs = np.where(real @ real[w.argmax()] < 0, -1, 1)
        r, d = (w * signs) @ real, (w * signs) @ dual
        r, d = r / np.linalg.norm(r), d / np.linalg.norm(r)
        a, u, b, v = r[0], r[1:], d[0], d[1:]
        found.append(p + 2 * np.cross(u, np.cross(u, p) + a * p) + 2 * (a * v - b * u + np.cross(u, v)))
    return np.array(found)


def figures(name, points, weights, joints, turns):
    motions = chain(joints, turns)
    scaled = [m.copy() for m in motions]
    # The last but one joint grows, and what hangs on it.
    for m in scaled[-2:]:
        about = scaled[-2] @ np.append(joints[-2], 1)
        m[:] = np.column_stack([1.3 * m[:, :3], about + 1.3 * (m[:, 3] - about)])
    results = {
        "linear": linear(points, weights, motions),
        "dual-quaternion": dual_quaternion(points, weights, motions),
        "linear, scaled": linear(points, weights, scaled),
    }
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    gap = np.abs(results["linear"] - results["dual-quaternion"]).max() / diagonal
    print(f"{name}: {len(points)} vertices; the two methods differ by {gap:.2g} of the diagonal")
    keep = slice(None, None, EVERY[name])
    return {
        "vertices": len(points),
        "fingerprint": goldens.fingerprint(points, weights),
        "diagonal": round(diagonal, 7),
        "motions": [m.tolist() for m in motions],
        "scaled": [m.tolist() for m in scaled],
        "every": EVERY[name],
        "positions": {k: [[round(x, 7) for x in p] for p in v[keep].tolist()] for k, v in results.items()},
    }


def main():
    path = HERE / "skinning.json"
    known = goldens.read(path)
    known["tube"] = figures("tube", *tube())
    if len(sys.argv) > 1:
        known["arm"] = figures("arm", *arm(Path(sys.argv[1])))
    goldens.write(path, known)


if __name__ == "__main__":
    main()
