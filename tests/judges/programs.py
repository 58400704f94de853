"""Other programs deform the samples: each opens samples.ply, sees its normals, colours and ids, moves it, saves it, and
SIMOD takes what it saved.

    python -m venv judges && judges/bin/pip install -r tests/judges/programs-requirements.txt
    judges/bin/python tests/judges/programs.py target/release/simod

Blender (bpy) is left out where it is not installed.
"""

import pathlib
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

import ply_files

SIMOD = str(pathlib.Path(sys.argv[1]).resolve())
SIDE = 120
SHIFT = np.array([0.0, 0.0, 0.25])


def simod(*words, ok=True):
    done = subprocess.run([SIMOD, *map(str, words)], capture_output=True, text=True)
    assert (done.returncode == 0) == ok, f"simod {' '.join(map(str, words))}: {done.stdout}{done.stderr}"
    return done


def write_model(path):
    u, v = (a.ravel() for a in np.meshgrid(np.arange(SIDE) / SIDE, np.arange(SIDE) / SIDE, indexing="ij"))
    records = np.zeros(SIDE * SIDE, [("p", "<f4", 3), ("c", "u1", 3)])
    records["p"] = np.stack([u, v, 0.1 * np.sin(6 * u)], 1)
    records["c"] = np.stack([250 * u, 250 * v, 0 * u + 99], 1)
    k = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel()
    faces = np.zeros(2 * len(a), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"] = 3
    faces["v"] = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    names = "".join(f"property float {n}\n" for n in "xyz")
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


def by_open3d(samples, out):
    mesh = open3d.io.read_triangle_mesh(str(samples))
    before = ply_files.vertices(samples)
    assert len(mesh.vertices) == len(before) and mesh.has_vertex_normals() and mesh.has_triangles()
    assert np.allclose(np.asarray(mesh.vertex_colors)[:, 1] * 255, before["green"], atol=1)
    open3d.io.write_triangle_mesh(str(out), mesh.translate(SHIFT), write_ascii=False)


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
    records = np.zeros(len(order), [("p", "<f4", 3), ("id", "<f4")])
    records["p"] = np.stack([before[c] for c in "xyz"], 1)[order] + SHIFT
    records["id"] = before["id"][order]
    names = "".join(f"property float {n}\n" for n in ("x", "y", "z", "scalar_id"))
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


def judge(name, by, folder, samples, expected):
    out = folder / "deformed.ply"
    out.unlink(missing_ok=True)
    by(samples, out)
    simod("reconstruct", folder / "m.simod", "--deformed", out, "-o", folder / "out.ply")
    found = ply_files.vertices(folder / "out.ply")
    off = max(np.abs(found[c] - expected[c]).max() for c in "xyz")
    assert off < 1e-5, f"{name}: off by {off}"
    ids = b"id\n" in out.read_bytes()[:2000] or b"scalar_id" in out.read_bytes()[:2000]
    print(f"{name}: as it should be ({'with' if ids else 'without'} ids), off by at most {off:.1e}")


with tempfile.TemporaryDirectory() as name:
    folder = pathlib.Path(name)
    write_model(folder / "m.ply")
    simod("sample", folder / "m.ply", "-o", folder / "m.simod", "--samples", 1200)
    samples = folder / "m.simod" / "samples.ply"
    expected = {c: ply_files.vertices(folder / "m.ply")[c] + shift for c, shift in zip("xyz", SHIFT)}
    judges = {
        "MeshLab": by_meshlab,
        "Open3D, mesh": by_open3d,
        "Open3D, cloud in another order": by_open3d_points,
        "CloudCompare's file, in another order": by_cloudcompare,
    }
    if bpy:
        judges["Blender"] = by_blender
    for name, by in judges.items():
        judge(name, by, folder, samples, expected)
    # Vertices that a program merges are missed.
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(samples))
    meshes.apply_filter("meshing_merge_close_vertices", threshold=pymeshlab.PureValue(0.1))
    meshes.save_current_mesh(str(folder / "merged.ply"))
    done = simod("reconstruct", folder / "m.simod", "--deformed", folder / "merged.ply", "-o", folder / "x.ply", ok=False)
    assert "are gone" in done.stderr and "merge" in done.stderr, done.stderr
    print("MeshLab, vertices merged: refused:", done.stderr.splitlines()[0])
