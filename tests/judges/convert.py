"""Other libraries as judges of conversions: they read what `simod convert` writes, and compare it with what they read of the model.

    python -m venv judges && judges/bin/pip install -r tests/judges/convert-requirements.txt
    judges/bin/python tests/judges/convert.py target/release/simod
    judges/bin/python tests/judges/convert.py target/release/simod --measure 8000000

`--measure` compares times with those of the libraries doing the same, in turns, the best of three.
"""

import pathlib
import resource
import subprocess
import sys
import tempfile
import time

import laspy
import numpy as np
import open3d
import trimesh

import ply_files

SIMOD = str(pathlib.Path(sys.argv[1]).resolve())


def simod(*words):
    done = subprocess.run([SIMOD, *map(str, words)], capture_output=True, text=True)
    assert done.returncode == 0, f"simod {' '.join(map(str, words))}: {done.stdout}{done.stderr}"


def convert(model, out, *options):
    simod("convert", model, out, *options)
    return out


def cloud(path, count, version, form, extra=True):
    """A LAS or LAZ file with something in every field."""
    header = laspy.LasHeader(version=version, point_format=form)
    header.scales, header.offsets = [0.01, 0.001, 0.0001], [412000.0, 5318000.0, 0.0]
    if extra:
        header.add_extra_dim(laspy.ExtraBytesParams("height", "f4"))
        header.add_extra_dim(laspy.ExtraBytesParams("count of some", "u2"))
    las = laspy.LasData(header)
    rng = np.random.default_rng(form)
    u, v = np.divmod(np.arange(count), int(count**0.5))
    las.x, las.y = 412000 + u * 0.25, 5318000 + v * 0.25
    las.z = 500 + 9 * np.sin(u / 70) + rng.uniform(0, 0.05, count)
    old = form < 6
    small = {"return_number": 8 if old else 16, "number_of_returns": 8 if old else 16, "classification": 32 if old else 256}
    small |= {"scanner_channel": 4}
    for name in las.point_format.dimension_names:
        if name in "XYZ" or name in ("height", "count of some"):
            continue
        bits = las.point_format.dimension_by_name(name).num_bits
        if name == "gps_time":
            las[name] = rng.uniform(0, 1e9, count)
        elif name in small:
            las[name] = rng.integers(0, small[name], count)
        elif name in ("scan_angle_rank", "scan_angle"):
            las[name] = rng.integers(-90, 90, count)
        else:
            las[name] = rng.integers(0, 2**bits, count)
    if extra:
        las["height"] = rng.uniform(-5, 50, count).astype("f4")
        las["count of some"] = rng.integers(0, 65536, count)
    las.write(str(path))
    return path


RENAMED = {"scan_angle_rank": "scan_angle", "count of some": "count_of_some"}


def judge_clouds(folder):
    for version, form in [("1.2", 0), ("1.2", 1), ("1.2", 2), ("1.2", 3), ("1.4", 6), ("1.4", 7), ("1.4", 8)]:
        for name in ("a.las", "a.laz"):
            model = cloud(folder / name, 130_000, version, form)
            before = laspy.read(str(model))
            # A blank in a name is lost.
            ply = ply_files.vertices(convert(model, folder / "a.ply", "--lossy"))
            for axis in "xyz":
                assert np.abs(ply[axis] - before[axis]).max() < 1e-9
            for own in before.point_format.dimension_names:
                if own not in "XYZ":
                    theirs = RENAMED.get(own, own)
                    assert np.array_equal(ply[theirs], np.asarray(before[own])), f"{name} {form}: {own}"
            other = folder / ("b.laz" if name == "a.las" else "b.las")
            after = laspy.read(str(convert(model, other)))
            assert np.array_equal(before.points.array, after.points.array), f"{name} {form}"
            assert [str(d) for d in before.point_format] == [str(d) for d in after.point_format]
            back = convert(folder / "a.ply", folder / "back.laz", "--step", "0.0001", "--origin", "412000,5318000,0")
            after = laspy.read(str(back))
            assert after.header.point_format.id == form, after.header.point_format.id
            for own in before.point_format.dimension_names:
                if own in "XYZ":
                    integers = np.round((before[own.lower()] - after.header.offsets["XYZ".index(own)]) / 0.0001)
                    assert np.array_equal(after[own], integers), own
                else:
                    assert np.array_equal(after[RENAMED.get(own, own) if " " in own else own], before[own]), own
        print(f"LAS {version}, point format {form}: to PLY, to the other of LAS and LAZ, and back, as they should be")


def judge_meshes(folder):
    mesh = trimesh.creation.icosphere(5)
    mesh.vertices *= [1, 2, 3]
    count = len(mesh.vertices)
    vertices = np.zeros(count, [("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3)])
    vertices["p"], vertices["n"] = mesh.vertices, mesh.vertex_normals
    vertices["c"] = np.arange(3 * count).reshape(-1, 3) % 256
    faces = np.zeros(len(mesh.faces), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, mesh.faces
    names = [f"float {n}" for n in ("x", "y", "z", "nx", "ny", "nz")] + [f"uchar {n}" for n in ("red", "green", "blue")]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n" + "".join(f"property {n}\n" for n in names)
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    model = folder / "m.ply"
    model.write_bytes(head.encode() + vertices.tobytes() + faces.tobytes())
    for extension in ("ply", "obj", "off", "stl"):
        out = convert(model, folder / f"out.{extension}", "--lossy")
        theirs = trimesh.load(out, process=False)
        expected = vertices["p"][mesh.faces]
        assert np.array_equal(theirs.vertices[theirs.faces].astype("f4"), expected), extension
        if extension != "stl":
            assert np.array_equal(theirs.faces, mesh.faces), extension
        opened = open3d.io.read_triangle_mesh(str(out))
        assert len(opened.triangles) == len(faces), extension
        if extension in ("ply", "obj"):
            # Open3D puts vertices of OBJ in the order of the faces.
            normals = np.asarray(opened.vertex_normals)[np.asarray(opened.triangles)]
            assert np.allclose(normals, vertices["n"][mesh.faces], atol=1e-6), extension
        if extension == "ply":
            assert np.allclose(np.asarray(opened.vertex_colors) * 255, vertices["c"]), extension
        print(f"mesh to {extension}: as it should be, by trimesh and Open3D")
    for extension in ("pcd", "csv", "xyz", "xyzn"):
        out = convert(model, folder / f"out.{extension}", "--lossy")
        if extension == "csv":
            table = np.genfromtxt(out, delimiter=",", names=True)
            assert np.array_equal(table["blue"], vertices["c"][:, 2])
            assert np.array_equal(table["x"].astype("f4"), vertices["p"][:, 0])
        else:
            opened = open3d.io.read_point_cloud(str(out))
            assert np.array_equal(np.asarray(opened.points).astype("f4"), vertices["p"]), extension
            if extension == "pcd":
                assert np.allclose(np.asarray(opened.colors) * 255, vertices["c"])
            if extension in ("pcd", "xyzn"):
                assert np.allclose(np.asarray(opened.normals), vertices["n"], atol=1e-6), extension
        print(f"cloud to {extension}: as it should be")


def timed(work):
    """Processor and wall time, with the children's."""
    def spent():
        return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))

    start, before = time.time(), spent()
    work()
    return time.time() - start, spent() - before


def peak(model, out, options):
    """Peak anonymous memory as the program tells it, in MB."""
    done = subprocess.run([SIMOD, "convert", str(model), str(out), *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("peak memory"))
    return line.split()[2]


def las_to_ply(model, out):
    las = laspy.read(str(model))
    points = open3d.t.geometry.PointCloud(np.stack([las.x, las.y, las.z], 1))
    for name in las.point_format.dimension_names:
        if name not in "XYZ":
            points.point[name] = open3d.core.Tensor(np.asarray(las[name]).astype("f4").reshape(-1, 1))
    open3d.t.io.write_point_cloud(str(out), points)


def measure(folder, count):
    side = int(count**0.5)
    laz = cloud(folder / "l.laz", count, "1.4", 7, False)
    las = folder / "l.las"
    laspy.read(str(laz)).write(str(las))
    simod("generate", "-o", folder / "g.ply", "--vertices", count)
    jobs = [
        ("LAS to LAZ", las, "o.laz", lambda o: laspy.read(str(las)).write(str(o)), "laspy"),
        ("LAZ to LAS", laz, "o.las", lambda o: laspy.read(str(laz)).write(str(o)), "laspy"),
        ("LAZ to PLY", laz, "o.ply", lambda o: las_to_ply(laz, o), "laspy and Open3D"),
        ("PLY to STL", folder / "g.ply", "o.stl", lambda o: trimesh.load(folder / "g.ply", process=False).export(o), "trimesh"),
        ("PLY to OBJ", folder / "g.ply", "o.obj", lambda o: trimesh.load(folder / "g.ply", process=False).export(o), "trimesh"),
    ]
    for name, model, out, theirs, who in jobs:
        ours, others = [], []
        memory = peak(model, folder / out, ["--lossy"])
        for _ in range(3):
            ours.append(timed(lambda: simod("convert", model, folder / out, "--lossy")))
            others.append(timed(lambda: theirs(folder / ("their-" + out))))
        (wall, cpu), (their_wall, their_cpu) = min(ours), min(others)
        print(
            f"{name}, {side * side} vertices: {wall:.1f} s ({cpu:.1f} s of processors, {memory} MB); "
            f"{who} {their_wall:.1f} s ({their_cpu:.1f} s): {wall / their_wall:.2f}"
        )


with tempfile.TemporaryDirectory() as name:
    if "--measure" in sys.argv:
        measure(pathlib.Path(name), int(sys.argv[sys.argv.index("--measure") + 1]))
    else:
        judge_clouds(pathlib.Path(name))
        judge_meshes(pathlib.Path(name))
