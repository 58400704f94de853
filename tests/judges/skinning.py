"""libigl as judge of weights that are found: its bounded biharmonic weights on tetrahedra, beside those that SIMOD finds.

    python -m venv judges && judges/bin/pip install -r tests/judges/skinning-requirements.txt
    judges/bin/python tests/judges/skinning.py target/release/simod [FOLDER]

makes an elephant with 30 bones, and one with 18, has libigl find weights of both, and SIMOD by `biharmonic` and by
`geodesic`; with FOLDER, which has libigl's `arm.obj`, `arm.tgf` and `arm-weights.dmat`, the arm's too. SIMOD's weights are
read off the motion that a `pose` gives all vertices, three bones at a time. It prints the mean weight where libigl's exceed
0.99, local maxima between 0 and 1 (all of them, and those by more than 0.001), and by how much the weights of a vertex
differ in the mean: half the sum of their differences.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import igl
import igl.copyleft.tetgen as tetgen
import numpy as np

JOINTS = {
    "pelvis": (-0.8, 1.3, 0), "chest": (0.35, 1.35, 0), "neck": (0.75, 1.6, 0), "head": (1.05, 1.75, 0),
    "brow": (1.35, 1.7, 0), "trunk1": (1.45, 1.4, 0), "trunk2": (1.55, 0.95, 0), "trunk3": (1.6, 0.5, 0),
    "trunk-end": (1.75, 0.2, 0), "ear-l": (1.0, 1.8, 0.28), "ear-l-end": (0.8, 1.75, 0.8),
    "ear-r": (1.0, 1.8, -0.28), "ear-r-end": (0.8, 1.75, -0.8), "tail": (-1.2, 1.3, 0), "tail-end": (-1.45, 0.7, 0),
}
for end, along in ("f", 0.5), ("h", -0.75):
    for side, z in ("l", 0.3), ("r", -0.3):
        JOINTS |= {
            f"hip-{end}{side}": (along, 1.0, z), f"knee-{end}{side}": (along, 0.5, z),
            f"foot-{end}{side}": (along + 0.02, 0.1, z), f"toe-{end}{side}": (along + 0.14, 0.06, z),
        }
LEGS = ["fl", "fr", "hl", "hr"]
FINE = "pelvis chest neck head brow trunk1 trunk2 trunk3 trunk-end|head ear-l ear-l-end|head ear-r ear-r-end|pelvis tail tail-end"
FINE = "|".join([FINE] + [f"{'chest' if l[0] == 'f' else 'pelvis'} hip-{l} knee-{l} foot-{l} toe-{l}" for l in LEGS])
COARSE = "pelvis neck brow trunk2 trunk-end|neck ear-l ear-l-end|neck ear-r ear-r-end|pelvis tail tail-end"
COARSE = "|".join([COARSE] + [f"{'neck' if l[0] == 'f' else 'pelvis'} hip-{l} foot-{l}" for l in LEGS])


def capsule(p, a, b, from_radius, to_radius):
    a, b = np.array(a, float), np.array(b, float)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[:, None] * (b - a), axis=1) - from_radius - (to_radius - from_radius) * t


def ellipsoid(p, centre, radii):
    radii = np.array(radii, float)
    return (np.linalg.norm((p - centre) / radii, axis=1) - 1) * radii.min()


def distance(p):
    """Roughly, from the elephant's skin."""
    trunk = [(1.3, 1.6, 0.2), (1.45, 1.35, 0.16), (1.56, 0.9, 0.12), (1.6, 0.5, 0.09), (1.78, 0.16, 0.07)]
    tail = [(-1.15, 1.35, 0.08), (-1.25, 1.2, 0.06), (-1.46, 0.66, 0.05)]
    parts = [ellipsoid(p, (-0.2, 1.25, 0), (1.05, 0.62, 0.55)), ellipsoid(p, (1.05, 1.7, 0), (0.42, 0.42, 0.33))]
    parts.append(capsule(p, (0.4, 1.4, 0), (0.9, 1.65, 0), 0.38, 0.3))
    for chain in trunk, tail:
        for (x, y, r), (u, v, s) in zip(chain, chain[1:]):
            parts.append(capsule(p, (x, y, 0), (u, v, 0), r, s))
    outwards = np.array([-0.38, -0.05, 0.92]) / np.linalg.norm([-0.38, -0.05, 0.92])
    across = np.cross(outwards, [0, 1, 0])
    across /= np.linalg.norm(across)
    for side in 1, -1:
        q = p * [1, 1, side]
        ear = (q - [0.86, 1.72, 0.58]) @ np.stack([outwards, np.cross(across, outwards), across], 1)
        parts.append(ellipsoid(ear, (0, 0, 0), (0.42, 0.45, 0.06)))
        for x in 0.5, -0.75:
            parts.append(capsule(q, (x, 1.0, 0.3), (x, 0.12, 0.3), 0.22, 0.17))
            parts.append(capsule(q, (x, 0.12, 0.3), (x + 0.12, 0.08, 0.3), 0.17, 0.1))
    return -0.04 * np.log(np.exp(np.clip(-np.stack(parts, 1) / 0.04, -600, 600)).sum(1))


def elephant(step=0.07):
    low, high = np.array([-1.7, -0.2, -1.2]), np.array([2.1, 2.3, 1.2])
    counts = ((high - low) / step).astype(int) + 1
    axes = [low[a] + step * np.arange(counts[a]) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).transpose(2, 1, 0, 3).reshape(-1, 3)
    values = np.concatenate([distance(points[i : i + 100_000]) for i in range(0, len(points), 100_000)])
    return igl.marching_cubes(values, points, *map(int, counts), 0.0)[:2]


def skeleton(chains):
    bones = [pair for chain in chains.split("|") for pair in zip(chain.split(), chain.split()[1:])]
    ids = sorted({id for bone in bones for id in bone}, key=list(JOINTS).index)
    return ids, np.array([JOINTS[id] for id in ids], float), [(ids.index(a), ids.index(b)) for a, b in bones]


def read_skeleton(path):
    joints, bones = [part.split("\n") for part in path.read_text().split("#")[:2]]
    joints = [line.split() for line in joints if line.strip()]
    ids = [joint[0] for joint in joints]
    bones = [tuple(ids.index(id) for id in line.split()[:2]) for line in bones if line.strip()]
    return ids, np.array([[float(x) for x in joint[1:4]] for joint in joints]), bones


def reference(points, faces, joints, bones):
    """libigl's weights at the surface, of each bone."""
    bones, none = np.array(bones, np.int64), np.array([], np.int64)
    quiet = "pq1.5YQ"
    all_points, tets = tetgen.mesh_with_skeleton(
        points, faces.astype(np.int64), joints, none, bones, np.zeros((0, 2), np.int64), 10, quiet
    )[:2]
    weights = igl.bbw(all_points, tets, *igl.boundary_conditions(all_points, tets, joints, none, bones), max_iter=8)
    return weights[: len(points)]


def found(simod, folder, points, faces, ids, joints, bones, binding):
    """SIMOD's, of each bone."""
    igl.writeOBJ(str(folder / "model.obj"), points, faces)
    lines = [f"{id} {x} {y} {z}" for id, (x, y, z) in zip(ids, joints)] + ["#"]
    (folder / "bones.tgf").write_text("\n".join(lines + [f"{ids[a]} {ids[b]}" for a, b in bones]))
    with open(folder / "pose.txt", "w") as pose:
        for first in range(0, len(bones), 3):
            for bone in range(len(bones)):
                rows = np.eye(3, 4)
                if 0 <= bone - first < 3:
                    rows[bone - first, 3] = 1
                print(*rows.ravel(), file=pose)
    params = f'skeleton = "bones.tgf", pose = "pose.txt", method = "linear", influences = 64, binding = "{binding}"'
    session = '[model]\npath = "model.obj"\n[sampling]\nsamples = 100000\n[[step]]\ndeform = "skinning"\n'
    (folder / "edit.toml").write_text(f"{session}params = {{ {params} }}\n")
    weights = np.zeros((len(points), len(bones)))
    for frame, first in enumerate(range(0, len(bones), 3)):
        command = [simod, "run", "edit.toml", "-o", "moved.obj", "--force", "--exact", "--frame", frame]
        subprocess.run(list(map(str, command)), cwd=folder, check=True, capture_output=True)
        moved = igl.read_triangle_mesh(str(folder / "moved.obj"))[0] - points
        weights[:, first : first + 3] = moved[:, : len(bones) - first]
    return weights


def maxima(weights, faces, by):
    """Vertices whose weights are between 0 and 1, and exceed those of all neighbours."""
    beside = np.concatenate([faces[:, [a, b]] for a in range(3) for b in range(3) if a != b])
    most = np.full_like(weights, -np.inf)
    np.maximum.at(most, beside[:, 0], weights[beside[:, 1]])
    return int(((weights > most + by) & (weights > 1e-5) & (weights < 1 - 1e-5)).sum())


def compare(simod, name, points, faces, ids, joints, bones, expected):
    expected = expected / expected.sum(1, keepdims=True)
    whole = expected > 0.99
    print(f"{name}, {len(bones)} bones: libigl's {maxima(expected, faces, 0)} ({maxima(expected, faces, 1e-3)}) local maxima")
    for binding in "biharmonic", "geodesic":
        with tempfile.TemporaryDirectory() as folder:
            weights = found(simod, Path(folder), points, faces, ids, joints, bones, binding)
        print(
            f"    {binding:10} mean {weights[whole].mean():.4f} at {whole.sum()} places, local maxima "
            f"{maxima(weights, faces, 1e-5)} ({maxima(weights, faces, 1e-3)}), differs by "
            f"{np.abs(weights - expected).sum(1).mean() / 2:.4f}",
            flush=True,
        )


def main():
    simod = Path(sys.argv[1]).resolve()
    if len(sys.argv) > 2:
        folder = Path(sys.argv[2])
        points, faces = igl.read_triangle_mesh(str(folder / "arm.obj"))
        weights = igl.readDMAT(str(folder / "arm-weights.dmat"))
        compare(simod, "arm", points, faces, *read_skeleton(folder / "arm.tgf"), weights)
    points, faces = elephant()
    for chains in COARSE, FINE:
        ids, joints, bones = skeleton(chains)
        compare(simod, "elephant", points, faces, ids, joints, bones, reference(points, faces, joints, bones))


if __name__ == "__main__":
    main()
