"""Other libraries as judges of the formats: each writes a model, SIMOD turns it, and the library reads both files and
compares every attribute.

    python -m venv judges && judges/bin/pip install -r tests/judges/formats-requirements.txt
    judges/bin/python tests/judges/formats.py target/release/simod

A rigid motion of the samples is one of the model, exactly but for rounding; what the samples do not move keeps its bytes.
"""

import pathlib
import subprocess
import sys
import tempfile

import meshio
import numpy as np
import open3d
import pandas
import trimesh
from stl import Mode, mesh

SIMOD = str(pathlib.Path(sys.argv[1]).resolve())
SIDE = 80
ANGLE = 0.5
TURN = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1]])
SHIFT = np.array([0.25, -0.5, 1.0])


def model():
    """Positions, normals, faces and colours of a bumpy sheet."""
    u, v = (a.ravel() for a in np.meshgrid(np.arange(SIDE) / SIDE, np.arange(SIDE) / SIDE, indexing="ij"))
    p = np.stack([u, v, 0.2 * np.sin(5 * u) * np.cos(4 * v)], 1)
    n = np.stack([-np.cos(5 * u) * np.cos(4 * v), 0.8 * np.sin(5 * u) * np.sin(4 * v), np.ones_like(u)], 1)
    n /= np.linalg.norm(n, axis=1)[:, None]
    k = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    colours = np.stack([u, v, 0 * u + 0.5], 1)
    return p, n, faces, colours


P, N, F, C = model()


def turn(p, middle):
    """Positions turned about a point near them: local coordinates of samples are of single precision."""
    return (p - middle) @ TURN.T + middle + SHIFT


def turned(samples, out, middle):
    """Turns the samples of a PLY file."""
    content = samples.read_bytes()
    start = content.index(b"end_header\n") + 11
    lines = content[:start].decode().splitlines()
    count = int(next(l for l in lines if l.startswith("element vertex")).split()[2])
    names = [l.split() for l in lines if l.startswith("property") and "list" not in l]
    kinds = np.dtype([(name, "<f8" if kind == "double" else "<f4") for _, kind, name in names])
    data = np.frombuffer(content, kinds, count, start).copy()
    p = turn(np.stack([data[c].astype(float) for c in "xyz"], 1), middle)
    for c, values in zip("xyz", p.T):
        data[c] = values
    out.write_bytes(content[:start] + data.tobytes() + content[start + data.nbytes :])


def simod(*arguments):
    subprocess.run([SIMOD, *map(str, arguments)], check=True, capture_output=True)


def judge(name, write, read, digits, same=True):
    """`write` makes a file; `read` gives a dictionary of positions, normals and all that has to stay."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        path, out, again = folder / name, folder / f"out-{name}", folder / f"same-{name}"
        write(path)
        simod("sample", path, "-o", folder / "s", "--samples", "1000")
        simod("reconstruct", folder / "s", "--deformed", folder / "s/samples.ply", "-o", again)
        if same:
            assert again.read_bytes() == path.read_bytes(), f"{name}: an identity changes bytes"
        before = read(path)
        middle = np.round(np.mean(np.asarray(before["positions"], float), axis=0))
        turned(folder / "s/samples.ply", folder / "deformed.ply", middle)
        simod("reconstruct", folder / "s", "--deformed", folder / "deformed.ply", "-o", out)
        after = read(out)
        assert before.keys() == after.keys(), name
        for key in before:
            old, new = np.asarray(before[key], float), np.asarray(after[key], float)
            expected = turn(old, middle) if key == "positions" else old @ TURN.T if key == "normals" else old
            assert old.shape == new.shape and old.size > 0, f"{name}: {key} {old.shape} {new.shape}"
            off = np.abs(new - expected).max()
            bound = {"positions": digits, "normals": max(digits, 1e-4)}.get(key, 0)
            assert off <= bound, f"{name}: {key} off by {off}"
        print(f"{name}: {', '.join(f'{k} {len(v)}' for k, v in before.items())}")


def of_stl(path):
    m = mesh.Mesh.from_file(str(path), calculate_normals=False)
    unit = m.normals / np.linalg.norm(m.normals, axis=1)[:, None]
    return {"positions": m.vectors.reshape(-1, 3), "normals": unit, "attributes": m.attr}


def write_stl(mode):
    def write(path):
        m = mesh.Mesh(np.zeros(len(F), dtype=mesh.Mesh.dtype))
        m.vectors[:] = P[F]
        m.update_normals()
        m.normals[:] /= np.linalg.norm(m.normals, axis=1)[:, None]
        if mode == Mode.BINARY:
            m.attr[:, 0] = np.arange(len(F)) % 60000
        m.save(str(path), mode=mode, update_normals=False)

    return write


def of_trimesh(path):
    m = trimesh.load(path, process=False, maintain_order=True)
    found = {"positions": m.vertices, "faces": m.faces}
    if path.suffix == ".obj":
        found["normals"] = m.vertex_normals
    return found


def of_meshio(path):
    m = meshio.read(path)
    return {"positions": m.points, "faces": m.cells_dict["triangle"]}


def of_cloud(path):
    c = open3d.io.read_point_cloud(str(path))
    found = {"positions": c.points}
    if c.has_normals():
        found["normals"] = c.normals
    if c.has_colors():
        found["colours"] = c.colors
    return found


def cloud(normals=True, colours=True):
    c = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(P.copy()))
    if normals:
        c.normals = open3d.utility.Vector3dVector(N.copy())
    if colours:
        c.colors = open3d.utility.Vector3dVector(C.copy())
    return c


def write_cloud(which, **how):
    return lambda path: open3d.io.write_point_cloud(str(path), which, **how)


def table():
    columns = {"id": np.arange(len(P)), "x": P[:, 0] + 512345, "y": P[:, 1] + 5412345, "z": P[:, 2], "class": 7}
    return pandas.DataFrame(columns)


def of_table(path):
    t = pandas.read_csv(path)
    return {"positions": t[["x", "y", "z"]], "others": t[["id", "class"]]}


def mesh_of_open3d():
    m = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(P.copy()), open3d.utility.Vector3iVector(F.copy()))
    m.vertex_normals = open3d.utility.Vector3dVector(N.copy())
    m.vertex_colors = open3d.utility.Vector3dVector(C.copy())
    return m


def of_mesh(path):
    m = open3d.io.read_triangle_mesh(str(path))
    found = {"positions": m.vertices, "faces": m.triangles}
    if m.has_vertex_colors():
        found["colours"] = m.vertex_colors
    return found


def main():
    judge("binary.stl", write_stl(Mode.BINARY), of_stl, 1e-6)
    judge("ascii.stl", write_stl(Mode.ASCII), of_stl, 2e-6)
    of_library = trimesh.Trimesh(P.copy(), F.copy(), vertex_normals=N.copy(), process=False)
    judge("trimesh.obj", lambda p: of_library.export(p, include_normals=True), of_trimesh, 1e-6)
    judge("trimesh.off", lambda p: of_library.export(p), of_trimesh, 1e-6)
    judge("meshio.obj", lambda p: meshio.Mesh(P, [("triangle", F)]).write(p), of_meshio, 1e-6)
    judge("meshio.off", lambda p: meshio.Mesh(P, [("triangle", F)]).write(p), of_meshio, 1e-6)
    judge("open3d.obj", lambda p: open3d.io.write_triangle_mesh(str(p), mesh_of_open3d()), of_mesh, 2e-6)
    judge("open3d.off", lambda p: open3d.io.write_triangle_mesh(str(p), mesh_of_open3d()), of_mesh, 2e-5)
    judge("ascii.pcd", write_cloud(cloud(), write_ascii=True), of_cloud, 2e-6)
    judge("binary.pcd", write_cloud(cloud()), of_cloud, 2e-6)
    # What is written is not compressed.
    judge("compressed.pcd", write_cloud(cloud(), compressed=True), of_cloud, 2e-6, same=False)
    judge("cloud.xyz", write_cloud(cloud(False, False)), of_cloud, 1e-6)
    judge("cloud.xyzn", write_cloud(cloud(True, False)), of_cloud, 1e-6)
    judge("cloud.xyzrgb", write_cloud(cloud(False, True)), of_cloud, 1e-6)
    judge("cloud.pts", write_cloud(cloud(False, True)), of_cloud, 1e-6)
    judge("table.csv", lambda p: table().to_csv(p, index=False, float_format="%.4f"), of_table, 1e-4)


main()
