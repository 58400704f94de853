"""Other programs deform the samples: each opens samples.ply, sees its normals, colours and ids, moves it, saves it, and
SIMOD takes what it saved: of a model near the origin, and of one in UTM coordinates, of type double.

    python -m venv judges && judges/bin/pip install -r tests/judges/programs-requirements.txt
    judges/bin/python tests/judges/programs.py target/release/simod

Blender (bpy) is left out where it is not installed.
"""

import pathlib
import re
import subprocess
import sys
import tempfile

# First, as it has its own versions of what Open3D brings along.
try:
    import bpy
except ImportError:
    bpy = None

import numpy as np
import open3d
import pymeshlab
import trimesh

import ply_files

SIMOD = str(pathlib.Path(sys.argv[1]).resolve())
SIDE = 120
SHIFT = np.array([0.0, 0.0, 0.25])


def simod(*words, ok=True):
    done = subprocess.run([SIMOD, *map(str, words)], capture_output=True, text=True)
    assert (done.returncode == 0) == ok, f"simod {' '.join(map(str, words))}: {done.stdout}{done.stderr}"
    return done


UTM = np.array([412345.678, 5318765.432, 500.0])


def write_model(path, kind="f4", scale=1.0, origin=np.zeros(3)):
    u, v = (a.ravel() for a in np.meshgrid(np.arange(SIDE) / SIDE, np.arange(SIDE) / SIDE, indexing="ij"))
    records = np.zeros(SIDE * SIDE, [("p", "<" + kind, 3), ("c", "u1", 3)])
    records["p"] = origin + scale * np.stack([u, v, 0.1 * np.sin(6 * u)], 1)
    records["c"] = np.stack([250 * u, 250 * v, 0 * u + 99], 1)
    k = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel()
    faces = np.zeros(2 * len(a), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"] = 3
    faces["v"] = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    names = "".join(f"property {'float' if kind == 'f4' else 'double'} {n}\n" for n in "xyz")
    names += "".join(f"property uchar {n}\n" for n in ("red", "green", "blue"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(records)}\n{names}"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(head.encode() + records.tobytes() + faces.tobytes())


def by_meshlab(samples, out):
    """MeshLab drops ids, and keeps the order."""
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(samples))
    mesh = meshes.current_mesh()
    before = ply_files.vertices(samples)
    assert mesh.vertex_number() == len(before) and mesh.face_number() > 0
    assert np.allclose(mesh.vertex_color_matrix()[:, 0] * 255, before["red"], atol=1)
    assert np.allclose(mesh.vertex_normal_matrix()[:, 2], before["nz"], atol=1e-5)
    meshes.apply_filter("compute_matrix_from_translation", traslmethod="XYZ translation", axisz=float(SHIFT[2]))
    meshes.save_current_mesh(str(out), save_vertex_color=True)


def by_meshlab_off(samples, out):
    """As NCOFF, which has colours before normals."""
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(samples))
    meshes.apply_filter("compute_matrix_from_translation", traslmethod="XYZ translation", axisz=float(SHIFT[2]))
    meshes.save_current_mesh(str(out.with_suffix(".off")))
    return out.with_suffix(".off")


def by_trimesh(samples, out):
    mesh = trimesh.load(samples, process=False)
    assert len(mesh.vertices) == len(ply_files.vertices(samples)) and len(mesh.faces) > 0
    mesh.apply_translation(SHIFT)
    mesh.export(out)


def by_trimesh_obj(samples, out):
    mesh = trimesh.load(samples, process=False)
    mesh.apply_translation(SHIFT)
    mesh.export(out.with_suffix(".obj"))
    return out.with_suffix(".obj")


def by_open3d(samples, out):
    mesh = open3d.io.read_triangle_mesh(str(samples))
    before = ply_files.vertices(samples)
    assert len(mesh.vertices) == len(before) and mesh.has_vertex_normals() and mesh.has_triangles()
    assert np.allclose(np.asarray(mesh.vertex_colors)[:, 1] * 255, before["green"], atol=1)
    open3d.io.write_triangle_mesh(str(out), mesh.translate(SHIFT), write_ascii=False)


def by_open3d_ascii(samples, out):
    mesh = open3d.io.read_triangle_mesh(str(samples))
    open3d.io.write_triangle_mesh(str(out), mesh.translate(SHIFT), write_ascii=True)


def by_open3d_tensors(samples, out):
    """A mesh of tensors: singles, in a file of doubles."""
    mesh = open3d.t.io.read_triangle_mesh(str(samples))
    mesh.translate(open3d.core.Tensor(SHIFT.astype("f4")))
    open3d.t.io.write_triangle_mesh(str(out), mesh)


def by_open3d_points(samples, out):
    """As a cloud of tensors, which keep the ids, and shuffled."""
    cloud = open3d.t.io.read_point_cloud(str(samples))
    before = ply_files.vertices(samples)
    assert np.array_equal(cloud.point["id"].numpy().ravel(), before["id"])
    assert np.array_equal(cloud.point["colors"].numpy()[:, 0], before["red"])
    order = np.random.default_rng(5).permutation(len(before))
    some = open3d.t.geometry.PointCloud(cloud.point["positions"].numpy()[order] + SHIFT.astype("f4"))
    some.point["id"] = open3d.core.Tensor(cloud.point["id"].numpy()[order].astype("f4").reshape(-1, 1))
    open3d.t.io.write_point_cloud(str(out), some)


def by_cloudcompare(samples, out):
    """What CloudCompare writes: ids as scalar_id, of type float, here in another order."""
    before = ply_files.vertices(samples)
    order = np.random.default_rng(7).permutation(len(before))
    # Near the origin, of type float; with the global shift undone, of type double.
    kind, name = ("<f4", "float") if before["x"].dtype == np.dtype("<f4") else ("<f8", "double")
    records = np.zeros(len(order), [("p", kind, 3), ("id", "<f4")])
    records["p"] = np.stack([before[c] for c in "xyz"], 1)[order] + SHIFT
    records["id"] = before["id"][order]
    names = "".join(f"property {name} {n}\n" for n in "xyz") + "property float scalar_id\n"
    head = f"ply\nformat binary_little_endian 1.0\ncomment Created by CloudCompare\nelement vertex {len(order)}\n{names}"
    out.write_bytes((head + "end_header\n").encode() + records.tobytes())


def by_blender(samples, out):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.ply_import(filepath=str(samples))
    mesh = bpy.context.selected_objects[0].data
    before = ply_files.vertices(samples)
    assert len(mesh.vertices) == len(before) and len(mesh.polygons) > 0 and len(mesh.color_attributes) == 1
    for vertex in mesh.vertices:
        vertex.co.z += SHIFT[2]
    bpy.ops.wm.ply_export(
        filepath=str(out), forward_axis="Y", up_axis="Z", export_attributes=True, export_triangulated_mesh=False
    )


def apart(stderr):
    """How far apart SIMOD says that the coordinates are, in the model's unit; zero where it says nothing."""
    found = re.search(r"its coordinates are (\S+) apart", stderr)
    return float(found.group(1)) if found else 0.0


def judge(name, by, folder, scale, coarse):
    """Coordinates that come back are so far apart, at most; what does not move stays, and what does is off by no more."""
    out = folder / "deformed.ply"
    for old in folder.glob("deformed.*"):
        old.unlink()
    (folder / "out.ply").unlink(missing_ok=True)
    samples = folder / "m.simod" / "samples.ply"
    out = by(samples, out) or out
    done = simod("reconstruct", folder / "m.simod", "--deformed", out, "-o", folder / "out.ply")
    before, found = ply_files.vertices(folder / "m.ply"), ply_files.vertices(folder / "out.ply")
    off = max(np.abs(found[c] - before[c] - shift).max() for c, shift in zip("xyz", SHIFT))
    assert off < 1e-5 * scale + 1e-4 * coarse, f"{name}: off by {off}"
    assert apart(done.stderr) <= coarse, f"{name}: {done.stderr}"
    assert (apart(done.stderr) > 0) == (coarse > 0), f"{name}: {done.stderr}"
    ids = b"id\n" in out.read_bytes()[:2000] or b"scalar_id" in out.read_bytes()[:2000]
    said = f", coordinates {apart(done.stderr):.1e} apart" if coarse else ""
    print(f"{name}: as it should be ({'with' if ids else 'without'} ids), off by at most {off:.1e}{said}")


def judge_all(folder, scale, coarse):
    """Singles of UTM coordinates are half a metre apart, six digits ten metres."""
    single, digits = (0.5, 10.0) if coarse else (0.0, 0.0)
    judge("MeshLab", by_meshlab, folder, scale, 0.0)
    judge("MeshLab, OFF", by_meshlab_off, folder, scale, 0.0)
    judge("Open3D, mesh", by_open3d, folder, scale, 0.0)
    if coarse:
        judge("Open3D, ascii", by_open3d_ascii, folder, scale, digits)
    judge("Open3D, mesh of tensors", by_open3d_tensors, folder, scale, single)
    judge("Open3D, cloud in another order", by_open3d_points, folder, scale, 0.0)
    judge("trimesh", by_trimesh, folder, scale, single)
    judge("trimesh, OBJ", by_trimesh_obj, folder, scale, 0.0)
    judge("CloudCompare's file, in another order", by_cloudcompare, folder, scale, 0.0)
    if bpy:
        judge("Blender", by_blender, folder, scale, single)


def judge_merged(folder):
    """Vertices that a program merges are missed."""
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(folder / "m.simod" / "samples.ply"))
    meshes.apply_filter("meshing_merge_close_vertices", threshold=pymeshlab.PureValue(0.1))
    meshes.save_current_mesh(str(folder / "merged.ply"))
    done = simod("reconstruct", folder / "m.simod", "--deformed", folder / "merged.ply", "-o", folder / "x.ply", ok=False)
    assert "are gone" in done.stderr and "merge" in done.stderr, done.stderr
    print("MeshLab, vertices merged: refused:", done.stderr.splitlines()[0])


for words in ({}, {"kind": "f8", "scale": 100.0, "origin": UTM}):
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        print("In UTM coordinates:" if words else "Near the origin:")
        write_model(folder / "m.ply", **words)
        simod("sample", folder / "m.ply", "-o", folder / "m.simod", "--samples", 1200)
        judge_all(folder, words.get("scale", 1.0), bool(words))
        if not words:
            judge_merged(folder)
