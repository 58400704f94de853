"""pycpd and probreg as judges of `register`: coherent point drift by each of them, beside SIMOD's, on the same pairs.

    python -m venv judges && judges/bin/pip install -r tests/judges/register-requirements.txt
    judges/bin/python tests/judges/register.py target/release/simod FOLDER [WORD…]

makes pairs of FOLDER's `arm.obj` with `arm-weights.dmat` and `arm.tgf`, `stanford-bunny.obj`, `armadillo.obj`, `horse.ply`
and `nefertiti.obj`, those that are there: the model, and a cloud of 60 000 points that lie at random on what a known map has
made of it. Of each pair there are four: all of the cloud; with noise of 0.3 % of the diagonal and without normals; without
a third of the cloud; without a third of the model. SIMOD has 5000 samples of the model. pycpd and probreg have 1500 points of
these samples and 1500 of the cloud, each as far from each other as can be, about 0 and of unit variance, and what they find is
carried over to all samples by their own Gaussians. Printed are the root of the mean square of the distances between where samples
should be and where they are, as a part of the model's diagonal, of those that have a counterpart and, behind a `+`, of those that
have none; and the seconds that each takes (of SIMOD the whole command). WORDs choose pairs and methods by parts of their names.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import ply_files
from scipy.spatial import cKDTree


POINTS, CLOUD, SAMPLES, NOISE = 1500, 60_000, 5000, 0.003
CONDITIONS = ("whole", "noise", "third of target gone", "third of model gone")
METHODS = {
    "nothing": None,
    "rigid": 'method = "align"',
    "cpd": 'method = "cpd"',
    "icp": 'method = "icp"',
    "default": "",
}


def read_obj(path):
    """Positions and triangles."""
    points, faces = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            points.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(w.split("/")[0]) - 1 for w in words[1:]]
            faces += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return np.array(points), np.array(faces)


def read_ply(path):
    """Positions and triangles, which come behind them."""
    data, start, vertices = ply_files.read(path)
    faces = np.frombuffer(data, np.dtype([("corners", "u1"), ("of", "<u4", 3)]), offset=start + vertices.nbytes)
    return positions(vertices), faces["of"].astype(np.int64)


def positions(vertices):
    return np.stack([vertices[axis] for axis in "xyz"], 1).astype(float)


def write_ply(path, points, normals=None, faces=None):
    fields = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    rows = points if normals is None else np.hstack([points, normals])
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {field}" for field in fields]
    tail = b""
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        table = np.zeros(len(faces), np.dtype([("corners", "u1"), ("of", "<i4", 3)]))
        table["corners"], table["of"] = 3, faces
        tail = table.tobytes()
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + rows.astype("<f4").tobytes() + tail)


class Box:
    """A model's box, whose longest axis is `along`."""

    def __init__(self, points):
        self.low, self.high = points.min(0), points.max(0)
        self.size, self.middle = self.high - self.low, 0.5 * (self.low + self.high)
        self.diagonal = np.linalg.norm(self.size)
        self.along = int(np.argmax(self.size))


def about(axis, angles):
    """Turns about an axis, one for each angle."""
    cross = np.cross(np.eye(3), np.eye(3)[axis])
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sin * cross.T + (1 - cos) * (cross @ cross)


def bump(box):
    """A bulge on one side, of a tenth of the diagonal."""
    at = box.middle + 0.3 * box.size * [1, 0.4, 0.2]
    push = 0.1 * box.diagonal * np.array([0.6, 0.64, 0.48])
    return lambda p: p + np.exp(-((p - at) ** 2).sum(1) / (0.2 * box.diagonal) ** 2)[:, None] * push


def bend(box):
    """By 50 degrees along the longest axis, which keeps its length."""
    a, b = box.along, (box.along + 1) % 3
    curvature = np.radians(50) / box.size[a]

    def image(p):
        q = p - box.middle
        angle, radius = q[:, a] * curvature, 1 / curvature - q[:, b]
        q[:, a], q[:, b] = np.sin(angle) * radius, 1 / curvature - np.cos(angle) * radius
        return q + box.middle

    return image


def twist(box):
    """By 60 degrees along the longest axis."""

    def image(p):
        angles = np.radians(60) * (p[:, box.along] - box.middle[box.along]) / box.size[box.along]
        return np.einsum("nij,nj->ni", about(box.along, angles), p - box.middle) + box.middle

    return image


def pose(data, points):
    """The arm, by its own weights: 30 degrees at the elbow and 20 at the wrist."""
    numbers = (data / "arm-weights.dmat").read_text().split()
    weights = np.array(numbers[2:], float).reshape(int(numbers[0]), int(numbers[1])).T
    lines = (data / "arm.tgf").read_text().split("#")[0].splitlines()
    joints = np.array([[float(x) for x in line.split()[1:4]] for line in lines if line.strip()])
    maps, turn, shift = [], np.eye(3), np.zeros(3)
    for bone, degrees in enumerate([0, 30, 20, 0]):
        pivot = joints[bone]
        local = about(2, np.radians([degrees]))[0]
        # The bone's own turn first, then those of the bones before it.
        shift = turn @ (pivot - local @ pivot) + shift
        turn = turn @ local
        maps.append((turn, shift))
    images = np.array([points @ turn.T + shift for turn, shift in maps])
    moved = np.einsum("nb,bnk->nk", weights, images) - points
    tree = cKDTree(points)

    def image(p):
        far, near = tree.query(p, k=4)
        share = 1 / np.maximum(far, 1e-9)
        return p + np.einsum("nk,nkj->nj", share / share.sum(1, keepdims=True), moved[near])

    return image


def pairs(data):
    """Name, points, triangles and map of each model that is there."""
    for name, file, made in [
        ("arm, posed", "arm.obj", None),
        ("bunny, bump", "stanford-bunny.obj", bump),
        ("armadillo, bent", "armadillo.obj", bend),
        ("horse, twisted", "horse.ply", twist),
        ("nefertiti, bump", "nefertiti.obj", bump),
        ("bunny, bent", "stanford-bunny.obj", bend),
    ]:
        if (data / file).is_file():
            points, faces = (read_obj if file.endswith("obj") else read_ply)(data / file)
            yield name, points, faces, pose(data, points) if made is None else made(Box(points))


def cloud_on(points, faces, generator):
    """Points at random on triangles, by area, and the normals there."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    chosen = generator.choice(len(faces), CLOUD, p=areas / areas.sum())
    u, v = generator.random((2, CLOUD, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    at = a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
    return at, normals[chosen] / areas[chosen, None]


def farthest(points, count):
    """Points as far from each other as can be."""
    apart, found = np.full(len(points), np.inf), [0]
    for _ in range(count - 1):
        apart = np.minimum(apart, ((points - points[found[-1]]) ** 2).sum(1))
        found.append(int(apart.argmax()))
    return points[found]


def gaussian(a, b, width):
    return np.exp(-((a[:, None] - b[None]) ** 2).sum(2) / (2 * width**2))


def carried(samples, source, weights, width):
    return np.vstack([block + gaussian(block, source, width) @ weights for block in np.array_split(samples, 20)])


def by_pycpd(samples, source, target):
    from pycpd import DeformableRegistration

    found = DeformableRegistration(X=target, Y=source, alpha=3, beta=2, w=0.1, max_iterations=150, tolerance=1e-5)
    found.register()
    return carried(samples, source, found.W, 2)


def by_probreg(samples, source, target):
    from probreg import cpd

    # Its kernel is exp(-d² / (2 beta)): the square of the paper's width.
    found = cpd.registration_cpd(source, target, tf_type_name="nonrigid", w=0.1, maxiter=150, tol=1e-5, beta=4, lmd=3)
    return carried(samples, source, found.transformation.w, 2)


OTHERS = {"pycpd": by_pycpd, "probreg": by_probreg}


def by_others(samples, cloud, run):
    """On points about 0 and of unit variance each, as the paper has them."""
    source, target = farthest(samples, POINTS), farthest(cloud[:20_000], POINTS)
    middles = source.mean(0), target.mean(0)
    scales = [np.sqrt(((p - m) ** 2).sum() / len(p)) for p, m in zip((source, target), middles)]
    start = time.time()
    found = run((samples - middles[0]) / scales[0], (source - middles[0]) / scales[0], (target - middles[1]) / scales[1])
    return found * scales[1] + middles[1], time.time() - start


def judge(simod, folder, name, condition, words, points, faces, image):
    def run(*command):
        done = subprocess.run([str(simod), *map(str, command)], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    box, generator = Box(points), np.random.default_rng(7)

    def gone(p):
        return p[:, box.along] > box.low[box.along] + 0.67 * box.size[box.along]

    moved, normals = cloud_on(image(points), faces, generator)
    if condition == "noise":
        moved += generator.normal(size=moved.shape) * NOISE * box.diagonal
        normals = None
    if condition == "third of target gone":
        # By where the points come from: the same ones of the same triangles at rest, but for the areas that choose them.
        at_rest = cKDTree(image(points)).query(moved)[1]
        kept = ~gone(points[at_rest])
        moved, normals = moved[kept], normals[kept]
    if condition == "third of model gone":
        faces = faces[~gone(points)[faces].any(1)]
    used = np.unique(faces)
    number = np.zeros(len(points), int)
    number[used] = np.arange(len(used))
    write_ply(folder / "model.ply", points[used], faces=number[faces])
    write_ply(folder / "target.ply", moved, normals)
    shutil.rmtree(folder / "model.simod", ignore_errors=True)
    run("sample", "model.ply", "-o", "model.simod", "--samples", SAMPLES)
    samples = positions(ply_files.vertices(folder / "model.simod/samples.ply"))
    truth = image(samples.copy())
    without = gone(samples) & (condition == "third of target gone")
    results = []
    for method, params in METHODS.items():
        if not chosen(words, [*METHODS, *OTHERS], method):
            continue
        start, found = time.time(), samples
        if params is not None:
            params = ", ".join(['target = "target.ply"', *filter(None, [params])])
            step = f'[[step]]\ndeform = "register"\nparams = {{ {params} }}\n'
            (folder / "edit.toml").write_text(f'[model]\npath = "model.ply"\n{step}')
            run("deform", "model.simod", "--session", "edit.toml", "-o", "out.ply", "--force")
            found = positions(ply_files.vertices(folder / "out.ply"))
        results.append((method, found, time.time() - start))
    for method, by in OTHERS.items():
        if chosen(words, [*METHODS, *OTHERS], method):
            results.append((method, *by_others(samples, moved, by)))
    line = []
    for method, found, seconds in results:
        off = ((found - truth) ** 2).sum(1)
        there = np.sqrt(off[~without].mean()) / box.diagonal
        beyond = f" + {100 * np.sqrt(off[without].mean()) / box.diagonal:.2f}" if without.any() else ""
        line.append(f"{method} {100 * there:.2f}{beyond} %, {seconds:.1f} s")
    print(f"{name}, {condition}: {'; '.join(line)}", flush=True)


def chosen(words, names, name):
    """Whether it is asked for: where no word is a part of any of the names, all are."""
    asked = [word for word in words if any(word in other for other in names)]
    return not asked or any(word in name for word in asked)


def main():
    simod, data, words = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve(), sys.argv[3:]
    with tempfile.TemporaryDirectory() as folder:
        there = list(pairs(data))
        for name, points, faces, image in there:
            for condition in CONDITIONS:
                if chosen(words, [n for n, *_ in there], name) and chosen(words, CONDITIONS, condition):
                    judge(simod, Path(folder), name, condition, words, points, faces, image)


if __name__ == "__main__":
    main()
