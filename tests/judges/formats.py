"""Other libraries as judges of the formats: each writes a model, SIMOD turns it, and the library reads both files and
compares every attribute.

    python -m venv judges && judges/bin/pip install -r tests/judges/formats-requirements.txt
    judges/bin/python tests/judges/formats.py target/release/simod
    judges/bin/python tests/judges/formats.py target/release/simod --measure 2000000 8000000

A rigid motion of the samples is one of the model, exactly but for rounding; what the samples do not move keeps its bytes.
`--measure` compares the time of `sample` and `reconstruct` with that of reading and writing the file by the libraries, whose
own start is left out.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import meshio
import numpy as np
import open3d
import pandas
import pygltflib
import trimesh
from stl import Mode, mesh

import ply_files

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("program", type=pathlib.Path)
parser.add_argument("--measure", type=int, nargs="+", metavar="VERTICES")
parser.add_argument("--of", nargs="+", metavar="ENDING", help="measure these formats alone")
OPTIONS = parser.parse_args()
SIMOD = str(OPTIONS.program.resolve())
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
    content, start, data = ply_files.read(samples)
    p = turn(np.stack([data[c].astype(float) for c in "xyz"], 1), middle)
    for c, values in zip("xyz", p.T):
        data[c] = values
    ply_files.write(out, content, start, data)


def simod(*arguments):
    subprocess.run([SIMOD, *map(str, arguments)], check=True, capture_output=True)


def judge(name, write, read, digits, same=True, becomes=None):
    """`write` makes a file; `read` gives a dictionary of positions, normals and all that has to stay."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        path, out, again = folder / name, folder / f"out-{name}", folder / f"same-{name}"
        if becomes:
            out, again = out.with_suffix(becomes), again.with_suffix(becomes)
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
            is_direction = key in ("normals", "tangents")
            expected = turn(old, middle) if key == "positions" else old @ TURN.T if is_direction else old
            assert old.shape == new.shape and old.size > 0, f"{name}: {key} {old.shape} {new.shape}"
            off = np.abs(new - expected).max()
            bound = digits if key == "positions" else max(digits, 1e-4) if is_direction else 0
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


class Gltf:
    """A file in the making, by pygltflib."""

    def __init__(self):
        self.gltf, self.data = pygltflib.GLTF2(scene=0, scenes=[pygltflib.Scene(nodes=[])]), b""

    def view(self, data, stride=None):
        view = pygltflib.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(data), byteStride=stride)
        self.gltf.bufferViews.append(view)
        self.data += data + bytes(-len(data) % 4)
        return len(self.gltf.bufferViews) - 1

    def accessor(self, view, offset, kind, count, shape, values=None, **rest):
        limits = {} if values is None else {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.gltf.accessors.append(
            pygltflib.Accessor(bufferView=view, byteOffset=offset, componentType=kind, count=count, type=shape, **limits, **rest)
        )
        return len(self.gltf.accessors) - 1

    def node(self, attributes, indices=None, mode=4, **node):
        primitive = pygltflib.Primitive(attributes=pygltflib.Attributes(**attributes), indices=indices, mode=mode)
        self.gltf.meshes.append(pygltflib.Mesh(primitives=[primitive]))
        self.gltf.nodes.append(pygltflib.Node(mesh=len(self.gltf.meshes) - 1, **node))
        self.gltf.scenes[0].nodes.append(len(self.gltf.nodes) - 1)

    def save(self, path):
        self.gltf.buffers = [pygltflib.Buffer(byteLength=len(self.data))]
        self.gltf.set_binary_blob(self.data)
        if path.suffix == ".gltf":
            # Where the buffer is written.
            self.gltf._path = path.parent
            self.gltf.convert_buffers(pygltflib.BufferFormat.BINFILE)
        self.gltf.save(path)


def tangents():
    t = np.stack([np.ones(len(N)), np.zeros(len(N)), N[:, 0] / -N[:, 2]], 1)
    t /= np.linalg.norm(t, axis=1)[:, None]
    return np.concatenate([t, np.where(np.arange(len(N)) % 2, 1, -1)[:, None]], 1)


def write_gltf(path):
    """Attributes between each other, and apart below a node that turns, scales and mirrors; points; what nobody knows."""
    g, f4, count = Gltf(), "<f4", len(P)
    p, n, t = P.astype(f4), N.astype(f4), tangents().astype(f4)
    rows = np.concatenate([n, p, P[:, :2].astype(f4), t], 1)
    view = g.view(rows.tobytes(), 48)
    normal = g.accessor(view, 0, pygltflib.FLOAT, count, "VEC3")
    position = g.accessor(view, 12, pygltflib.FLOAT, count, "VEC3", p)
    texture = g.accessor(view, 24, pygltflib.FLOAT, count, "VEC2")
    tangent = g.accessor(view, 32, pygltflib.FLOAT, count, "VEC4")
    colours = (np.concatenate([C, C[:, :1]], 1) * 255).astype("u1")
    colour = g.accessor(g.view(colours.tobytes(), 4), 0, pygltflib.UNSIGNED_BYTE, count, "VEC4", normalized=True)
    indices = g.accessor(g.view(F.astype("<u2").tobytes()), 0, pygltflib.UNSIGNED_SHORT, F.size, "SCALAR")
    g.node(dict(POSITION=position, NORMAL=normal, TANGENT=tangent, TEXCOORD_0=texture, COLOR_0=colour), indices)
    apart = dict(
        NORMAL=g.accessor(g.view(n.tobytes()), 0, pygltflib.FLOAT, count, "VEC3"),
        TANGENT=g.accessor(g.view(t.tobytes()), 0, pygltflib.FLOAT, count, "VEC4"),
        POSITION=g.accessor(g.view(p.tobytes()), 0, pygltflib.FLOAT, count, "VEC3", p),
    )
    indices = g.accessor(g.view(F.astype("<u4").tobytes()), 0, pygltflib.UNSIGNED_INT, F.size, "SCALAR")
    half = float(np.sqrt(0.5))
    g.node(apart, indices, rotation=[half, 0, 0, half], scale=[-0.5, 0.5, 0.5], translation=[2, 0, 0], extras={"a": 1})
    few = (P[:100] + [0, 0, 1]).astype(f4)
    g.node(dict(POSITION=g.accessor(g.view(few.tobytes()), 0, pygltflib.FLOAT, 100, "VEC3", few)), mode=0)
    g.save(path)


def accessor(gltf, blob, index):
    a = gltf.accessors[index]
    view = gltf.bufferViews[a.bufferView]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[a.componentType]
    numbers = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a.type]
    stride = view.byteStride or numbers * np.dtype(kind).itemsize
    start = (view.byteOffset or 0) + (a.byteOffset or 0)
    return np.ndarray((a.count, numbers), kind, blob, start, (stride, np.dtype(kind).itemsize))


def opened(path):
    """A file, and its binary data, once it is checked that limits are those of the numbers."""
    gltf = pygltflib.GLTF2().load(path)
    if path.suffix == ".gltf":
        gltf.convert_buffers(pygltflib.BufferFormat.BINARYBLOB)
    blob = gltf.binary_blob()
    for index, a in enumerate(gltf.accessors):
        values = accessor(gltf, blob, index)
        for told, found in [(a.min, values.min(0)), (a.max, values.max(0))]:
            assert not told or np.array_equal(np.float32(told), np.float32(found)), f"{path.name}: accessor {index}"
    return gltf, blob


def of_gltf(path):
    """All vertices where nodes take them, and all other numbers as they are."""
    gltf, blob = opened(path)
    found = {"positions": [], "normals": [], "tangents": []}
    for node in gltf.nodes:
        world = np.eye(4)
        if node.rotation:
            world = trimesh.transformations.quaternion_matrix(np.roll(node.rotation, 1))
        world[:3, :3] *= node.scale or 1
        world[:3, 3] = node.translation or 0
        linear = world[:3, :3]
        for name, kind, by in [
            ("positions", "POSITION", linear), ("normals", "NORMAL", np.linalg.inv(linear).T), ("tangents", "TANGENT", linear)
        ]:
            index = getattr(gltf.meshes[node.mesh].primitives[0].attributes, kind)
            if index is None:
                continue
            values = accessor(gltf, blob, index).astype(float)
            turned = values[:, :3] @ by.T
            if kind == "POSITION":
                turned += world[:3, 3]
            else:
                turned /= np.linalg.norm(turned, axis=1)[:, None]
            if kind == "TANGENT":
                found[f"w {index}"] = values[:, 3]
            found[name].append(turned)
    found = {key: np.concatenate(value) if isinstance(value, list) else value for key, value in found.items()}
    attributes = [mesh.primitives[0].attributes for mesh in gltf.meshes]
    changing = {getattr(a, kind) for a in attributes for kind in ("POSITION", "NORMAL", "TANGENT")}
    for index in range(len(gltf.accessors)):
        if index not in changing:
            found[f"accessor {index}"] = accessor(gltf, blob, index)
    # Another reader finds the same vertices.
    scene = trimesh.load(path, process=False, maintain_order=True)
    bounds = [found["positions"].min(0), found["positions"].max(0)]
    assert np.abs(np.asarray(scene.bounds) - bounds).max() < 1e-6
    return found


def of_trimesh_glb(path):
    opened(path)
    (mesh,) = trimesh.load(path, process=False).geometry.values()
    return {"positions": mesh.vertices, "normals": mesh.vertex_normals, "faces": mesh.faces}


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
    judge("trimesh.glb", lambda p: of_library.export(p, include_normals=True), of_trimesh_glb, 1e-6)
    judge("pygltflib.glb", write_gltf, of_gltf, 2e-6)
    # What is written is GLB.
    judge("pygltflib.gltf", write_gltf, of_gltf, 2e-6, same=False, becomes=".glb")
    # What is written is not compressed.
    judge("compressed.pcd", write_cloud(cloud(), compressed=True), of_cloud, 2e-6, same=False)
    judge("cloud.xyz", write_cloud(cloud(False, False)), of_cloud, 1e-6)
    judge("cloud.xyzn", write_cloud(cloud(True, False)), of_cloud, 1e-6)
    judge("cloud.xyzrgb", write_cloud(cloud(False, True)), of_cloud, 1e-6)
    judge("cloud.pts", write_cloud(cloud(False, True)), of_cloud, 1e-6)
    judge("table.csv", lambda p: table().to_csv(p, index=False, float_format="%.4f"), of_table, 1e-4)


# What reads `m.ENDING` and writes `other.ENDING`, by ending and library.
MESH = "open3d.io.write_triangle_mesh('other.{0}', open3d.io.read_triangle_mesh('m.{0}'))"
CLOUD = "open3d.io.write_point_cloud('other.{0}', open3d.io.read_point_cloud('m.{0}'))"
LIBRARIES = {
    "stl": {"trimesh": "trimesh.load('m.stl').export('other.stl')", "open3d": MESH},
    "obj": {"trimesh": "trimesh.load('m.obj').export('other.obj')", "open3d": MESH},
    "off": {"trimesh": "trimesh.load('m.off').export('other.off')", "open3d": MESH},
    "glb": {"trimesh": "trimesh.load('m.glb').export('other.glb')"},
    "xyzn": {"open3d": CLOUD},
    "pcd": {"open3d": CLOUD},
    "csv": {"pandas": "pandas.read_csv('m.csv').to_csv('other.csv', index=False)"},
}


def measure(counts):
    """The best of three runs in turns: seconds, seconds of processor time, and the peak of memory in MiB."""
    for count in counts:
        for ending, libraries in LIBRARIES.items():
            if OPTIONS.of and ending not in OPTIONS.of:
                continue
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                made = folder / f"m.{ending}"
                simod("generate", "--vertices", count, "-o", folder / "m.ply")
                if ending == "glb":
                    mesh = open3d.io.read_triangle_mesh(str(folder / "m.ply"))
                    normals = np.asarray(mesh.compute_vertex_normals().vertex_normals)
                    faces = np.asarray(mesh.triangles)
                    whole = trimesh.Trimesh(np.asarray(mesh.vertices), faces, vertex_normals=normals, process=False)
                    whole.export(made, include_normals=True)
                    del mesh, normals, faces, whole
                else:
                    simod("convert", folder / "m.ply", made, "--lossy")
                (folder / "m.ply").unlink()
                runs = {name: [] for name in [*libraries, "sample", "reconstruct"]}
                for _ in range(3):
                    for library, code in libraries.items():
                        code = f"t = time.perf_counter(), time.process_time()\n{code.format(ending)}\n"
                        code = f"import json, resource, time, {library}\n{code}"
                        code += "t = time.perf_counter() - t[0], time.process_time() - t[1]\n"
                        code += "print(json.dumps([*t, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))"
                        told = subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, capture_output=True)
                        runs[library].append(json.loads(told.stdout.splitlines()[-1]))
                    subprocess.run(["rm", "-rf", "m.simod", f"out.{ending}"], cwd=folder, check=True)
                    runs["sample"].append(timed(folder, "sample", made.name, "-o", "m.simod"))
                    turned(folder / "m.simod" / "samples.ply", folder / "moved.ply", 0.0)
                    line = ("reconstruct", "m.simod", "--deformed", "moved.ply", "-o", f"out.{ending}")
                    runs["reconstruct"].append(timed(folder, *line))
                print(f"{count} vertices, {ending} of {made.stat().st_size / 2**20:.0f} MiB")
                best = {name: [min(all) for all in zip(*times)] for name, times in runs.items()}
                for name, (wall, cpu, peak) in best.items():
                    ratios = ", ".join(f"{wall / best[library][0]:.2f} times {library}" for library in libraries)
                    own = "" if name in libraries else f" ({ratios})"
                    print(f"  {name}: {wall:.2f} s{own}, {cpu:.2f} s of processor time, {peak:.0f} MiB", flush=True)


def timed(folder, *words):
    """Seconds, seconds of processor time, and the peak of memory in MiB, which the program tells."""
    start = time.perf_counter()
    line = [SIMOD, "--json", *map(str, words)]
    process = subprocess.Popen(line, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    told = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, words
    peak = json.loads(told)["peak_memory_bytes"]
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, peak / 2**20


if OPTIONS.measure:
    measure(OPTIONS.measure)
else:
    main()
