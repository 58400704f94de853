"""libigl as judge of `laplacian`: its as rigid as possible, on the samples and triangles that SIMOD has, beside SIMOD's.

    python -m venv judges && judges/bin/pip install -r tests/judges/arap-requirements.txt
    judges/bin/python tests/judges/arap.py target/release/simod FOLDER

samples those of FOLDER's `arm.obj`, `armadillo.obj` and `decimated-knight.off` that are there, and a generated cylinder,
holds their lower quarter along their longest side, and turns their upper quarter. libigl does the same until its energy goes
down by less than 1e-7 of itself in 100 steps (2000 at most), from where no handle has moved, and once more from SIMOD's result. For each
energy (spokes and rims; spokes) and each way that SIMOD takes there stand: the energy as libigl has it and the volume,
both beside libigl's; the largest and the mean distance from libigl's; how far libigl's own descent gets the energy down from
there; and the seconds that the whole command takes.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import igl
import numpy as np
import ply_files

ENERGIES = {"spokes-and-rims": igl.ARAP_ENERGY_TYPE_SPOKES_AND_RIMS, "spokes": igl.ARAP_ENERGY_TYPE_SPOKES}
WAYS = {
    "as it comes": 'mode = "arap"',
    "cotangents": 'mode = "arap", weights = "cotangent"',
    "cotangents, to 1e-6": 'mode = "arap", weights = "cotangent", decrease = 1e-6',
    "smooth-arap": 'mode = "smooth-arap"',
}
TURNS = {"arm": 40, "armadillo": 40, "decimated-knight": 30, "cylinder": 60}
MODELS = {"arm": "arm.obj", "armadillo": "armadillo.obj", "decimated-knight": "decimated-knight.off"}


class Energy:
    """What libigl's descent lowers: the sum over surroundings of cotangents times squared differences of edges."""

    def __init__(self, points, triangles, kind):
        corners = igl.cotmatrix_entries(points, triangles)
        edges = [triangles[:, [(c + 1) % 3, (c + 2) % 3]] for c in range(3)]
        turning = range(3) if kind == "spokes-and-rims" else None
        parts = []
        for c in range(3):
            around = [triangles[:, t] for t in turning] if turning else edges[c].T
            parts += [(owner, edges[c], corners[:, c]) for owner in around]
        self.owners = np.concatenate([p[0] for p in parts])
        self.edges = np.concatenate([p[1] for p in parts])
        self.weights = np.concatenate([p[2] for p in parts]) / (3 if turning else 1)
        self.rest = points[self.edges[:, 1]] - points[self.edges[:, 0]]
        self.count = len(points)

    def of(self, points):
        now = points[self.edges[:, 1]] - points[self.edges[:, 0]]
        covariances = np.zeros((self.count, 3, 3))
        np.add.at(covariances, self.owners, self.weights[:, None, None] * now[:, :, None] * self.rest[:, None, :])
        u, _, vt = np.linalg.svd(covariances)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        turned = np.einsum("nij,nj->ni", (u @ vt)[self.owners], self.rest)
        return float((self.weights * ((now - turned) ** 2).sum(1)).sum())


def positions(vertices):
    return np.stack([vertices[axis] for axis in "xyz"], 1).astype(float)


def mesh(path):
    """Positions and triangles, which come behind them."""
    data, start, vertices = ply_files.read(path)
    faces = np.frombuffer(data, np.dtype([("corners", "u1"), ("of", "<u4", 3)]), offset=start + vertices.nbytes)
    return positions(vertices), faces["of"].astype(np.int64)


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] - points.mean(0) for k in range(3))
    return float(np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6)


def descend(points, triangles, held, goals, kind, start, energy):
    """libigl's descent, and the energies at its ends."""
    data = igl.ARAPData()
    data.max_iter, data.energy = 100, ENERGIES[kind]
    igl.arap_precomputation(points, triangles, 3, held.astype(np.int32), data)
    now = start.copy()
    now[held] = goals
    first = last = energy.of(now)
    for _ in range(20):
        now = igl.arap_solve(goals, data, now)
        before, last = last, energy.of(now)
        if before - last <= 1e-7 * last:
            break
    return now, first, last


def turn(points, degrees):
    """Regions along the longest side: a plane for what is fixed and one for the handle, and the motion."""
    low, high = points.min(0), points.max(0)
    along = int(np.argmax(high - low))
    bottom, top = low[along] + [0.25 * (high - low)[along], 0.75 * (high - low)[along]]
    axis = np.eye(3)[(along + 1) % 3]
    pivot = np.where(np.arange(3) == along, 0.5 * (low + high)[along], points.mean(0))
    angle = np.radians(degrees)
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return along, bottom, top, axis, pivot, rotation


def session(along, bottom, top, axis, pivot, degrees, params):
    def half_space(at, sign):
        point, normal = [0.0] * 3, [0.0] * 3
        point[along], normal[along] = float(at), sign
        return f"shapes = [{{ half-space = {{ point = {point}, normal = {normal} }} }}]"

    move = f"move = {{ axis = {axis.tolist()}, degrees = {degrees}, pivot = {pivot.tolist()} }}"
    step = f'[model]\npath = "model"\n[[step]]\ndeform = "laplacian"\nparams = {{ {params} }}\n'
    fixed = f'[[step.region]]\nrole = "fixed"\n{half_space(bottom, -1.0)}\n'
    return f'{step}{fixed}[[step.region]]\nrole = "handle"\n{half_space(top, 1.0)}\n{move}\n'


def judge(simod, folder, name, model, degrees):
    def run(*command):
        subprocess.run([str(simod), *map(str, command)], cwd=folder, check=True, capture_output=True)

    run("sample", model, "-o", name, "--samples", 5000)
    points, triangles = mesh(folder / name / "samples.ply")
    along, bottom, top, axis, pivot, _ = region = turn(points, degrees)
    results, seconds = {}, {}
    for kind in ENERGIES:
        for way, params in WAYS.items():
            if way == "smooth-arap" and kind == "spokes":
                continue
            more = "" if way == "smooth-arap" else f', surroundings = "{kind}"'
            (folder / "edit.toml").write_text(session(along, bottom, top, axis, pivot, degrees, params + more))
            start = time.time()
            run("deform", name, "--session", "edit.toml", "-o", "deformed.ply", "--force")
            seconds[kind, way] = time.time() - start
            results[kind, way] = positions(ply_files.vertices(folder / "deformed.ply"))
    # Samples that SIMOD holds are held for libigl, where SIMOD has them.
    sides = points[:, along]
    held = np.flatnonzero((sides <= bottom) | (sides >= top))
    goals = points[held].copy()
    above = sides[held] >= top
    goals[above] = (goals[above] - pivot) @ region[5].T + pivot
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    assert np.abs(results["spokes-and-rims", "cotangents"][held] - goals).max() < 1e-5 * diagonal, "other regions"
    free = np.setdiff1d(np.arange(len(points)), held)
    for kind in ENERGIES:
        energy = Energy(points, triangles, kind)
        expected, _, least = descend(points, triangles, held, goals, kind, points, energy)
        change = volume(expected, triangles) / volume(points, triangles) - 1
        print(f"{name}, {len(points)} samples, {len(free)} free, {kind}: libigl's energy {least:.6g}, volume {change:+.2%}", flush=True)
        for way in (way for of, way in results if of == kind):
            found = results[kind, way].copy()
            own = energy.of(found)
            _, _, after = descend(points, triangles, held, goals, kind, found, energy)
            apart = np.linalg.norm(found - expected, axis=1)[free] / diagonal
            change = volume(found, triangles) / volume(points, triangles) - 1
            print(
                f"    {way:20} energy {own / least:8.5f} of libigl's, then {after / least:8.5f}; volume {change:+.2%}; "
                f"{apart.max():.1e} of the diagonal apart, {apart.mean():.1e} in the mean; {seconds[kind, way]:.2f} s",
                flush=True,
            )


def main():
    simod, data = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        command = [str(simod), "generate", "--shape", "cylinder", "--vertices", "20000", "-o", "cylinder.ply"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        judge(simod, folder, "cylinder", folder / "cylinder.ply", TURNS["cylinder"])
        for name, file in MODELS.items():
            if (data / file).is_file():
                judge(simod, folder, name, data / file, TURNS[name])


if __name__ == "__main__":
    main()
