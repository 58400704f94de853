# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in Blender without a window: what modifiers make of samples is made of all vertices."""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import bpy
import numpy as np
import pytest

HERE = Path(__file__).parent.parent
SIMOD = os.environ["SIMOD_PROGRAM"]


@pytest.fixture(scope="session")
def extension(tmp_path_factory):
    """What is in the zip, registered."""
    folder = tmp_path_factory.mktemp("extension")
    path = Path(subprocess.check_output([sys.executable, HERE / "build.py", folder], text=True).strip())
    package = folder / "simod"
    with zipfile.ZipFile(path) as file:
        assert {"blender_manifest.toml", "__init__.py", "LICENSE"} <= set(file.namelist())
        file.extractall(package)
    where = {"submodule_search_locations": [str(package)]}
    spec = importlib.util.spec_from_file_location("simod_blender", package / "__init__.py", **where)
    module = importlib.util.module_from_spec(spec)
    sys.modules["simod_blender"] = module
    spec.loader.exec_module(module)
    module.register()
    yield module
    module.unregister()


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    """A jar of 100 000 vertices."""
    path = tmp_path_factory.mktemp("models") / "amphora.ply"
    subprocess.run([SIMOD, "generate", "--vertices", "100000", "-o", path], check=True)
    return path


@pytest.fixture
def imported(extension, model, tmp_path):
    """The samples of the jar in an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    done = bpy.ops.simod.import_samples(
        filepath=str(model), folder=str(tmp_path / "p_s"), preset="0", samples=8000, wait=True
    )
    assert done == {"FINISHED"}
    return bpy.context.object


def vertices(path):
    """Positions in a PLY file: (N, 3), float64."""
    from simod_blender.files import KINDS

    data = path.read_bytes()
    header = data[: data.index(b"end_header\n")].decode()
    lines = [line.split() for line in header.split("element face")[0].splitlines()]
    record = np.dtype([(line[2], KINDS[line[1]]) for line in lines if line[0] == "property"])
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    found = np.frombuffer(data, record, count, len(header) + len("end_header\n"))
    return np.stack([found[axis].astype(float) for axis in "xyz"], 1)


def write(path):
    assert bpy.ops.simod.write_model(filepath=str(path), wait=True) == {"FINISHED"}
    return vertices(path)


def by_blender(object, points):
    """Where the same modifiers take points, as a mesh of their own."""
    mesh = bpy.data.meshes.new("full")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    full = object.copy()
    full.data = mesh
    bpy.context.collection.objects.link(full)
    for group in object.vertex_groups:
        weights = np.zeros(len(points))
        height = points[:, 1]
        weights[:] = WEIGHTS[group.name](height)
        new = full.vertex_groups.get(group.name) or full.vertex_groups.new(name=group.name)
        for i in np.flatnonzero(weights):
            new.add([int(i)], float(weights[i]), "REPLACE")
    result = full.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = np.empty(3 * len(points), np.float32)
    result.to_mesh().vertices.foreach_get("co", found)
    result.to_mesh_clear()
    bpy.data.objects.remove(full)
    return found.reshape(-1, 3).astype(float)


def smooth(height):
    """From 0 to 1 over the jar's middle."""
    t = np.clip((height - 0.6) / 0.8, 0, 1)
    return t * t * (3 - 2 * t)


WEIGHTS = {"lower": lambda height: 1 - smooth(height), "upper": smooth}


def close(after, expected, part=2e-3):
    """All vertices are where they are expected, but for a part of the jar's size."""
    return np.linalg.norm(after - expected, axis=1).max() < part * 2.6


def test_import(imported, model, tmp_path):
    mesh = imported.data
    assert 7000 < len(mesh.vertices) <= 8000 and len(mesh.polygons) > len(mesh.vertices)
    assert {"simod_id", "Color"} <= set(mesh.attributes.keys())
    assert write(tmp_path / "same.ply").shape == vertices(model).shape
    assert (tmp_path / "same.ply").read_bytes() == model.read_bytes()


def test_moved_as_an_object(imported, model, tmp_path):
    imported.location = (1, 2, 3)
    imported.scale = (2, 2, 2)
    bpy.context.view_layer.update()
    assert close(write(tmp_path / "out.ply"), 2 * vertices(model) + [1, 2, 3], 1e-6)


def test_simple_deform(imported, model, tmp_path):
    twist = imported.modifiers.new("Twist", "SIMPLE_DEFORM")
    twist.deform_method, twist.deform_axis, twist.angle = "TWIST", "Y", 1.5
    after = write(tmp_path / "out.ply")
    assert close(after, by_blender(imported, vertices(model)), 5e-3)
    # Analytic: an angle that grows along y; heights stay.
    before = vertices(model)
    assert np.allclose(after[:, 1], before[:, 1], atol=5e-3) and np.abs(after - before).max() > 0.3
    radius = np.hypot(before[:, 0], before[:, 2])
    assert np.allclose(np.hypot(after[:, 0], after[:, 2]), radius, atol=1e-2)


def test_lattice(imported, model, tmp_path):
    lattice = bpy.data.lattices.new("Cage")
    lattice.points_u = lattice.points_v = lattice.points_w = 2
    for key in ("u", "v", "w"):
        setattr(lattice, f"interpolation_type_{key}", "KEY_LINEAR")
    cage = bpy.data.objects.new("Cage", lattice)
    cage.location, cage.scale = (0, 1, 0), (4, 4, 4)
    bpy.context.collection.objects.link(cage)
    bpy.context.view_layer.update()
    matrix = np.array([[1, 0.3, 0], [0, 1, 0.2], [0.1, 0, 1]])
    for point in lattice.points:
        point.co_deform = matrix @ np.array(point.co)
    imported.modifiers.new("Lattice", "LATTICE").object = cage
    # Trilinear in an affinely moved cage: an affine map about its middle.
    expected = (vertices(model) - [0, 1, 0]) @ matrix.T + [0, 1, 0]
    assert close(write(tmp_path / "out.ply"), expected, 1e-5)


def armature(imported):
    """Two bones along the jar, of which the upper one is bent by 40 degrees."""
    data = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", data)
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, start, end in (("lower", 0, 1), ("upper", 1, 2)):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = (0, start, 0), (0, end, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = imported
    heights = np.array([v.co.y for v in imported.data.vertices])
    for name, weight in WEIGHTS.items():
        group = imported.vertex_groups.new(name=name)
        for i, w in enumerate(weight(heights)):
            if w:
                group.add([i], float(w), "REPLACE")
    imported.modifiers.new("Armature", "ARMATURE").object = rig
    pose = rig.pose.bones["upper"]
    pose.rotation_mode = "XYZ"
    return pose


def test_armature(imported, model, tmp_path):
    armature(imported).rotation_euler = (0, 0, np.radians(40))
    bpy.context.view_layer.update()
    after = write(tmp_path / "out.ply")
    assert close(after, by_blender(imported, vertices(model)))
    before = vertices(model)
    still = before[:, 1] < 0.5
    assert np.allclose(after[still], before[still], atol=1e-3) and np.abs(after - before).max() > 0.3


def test_frames(imported, model, tmp_path):
    pose = armature(imported)
    for frame, degrees in ((1, 0), (3, 40)):
        pose.rotation_euler = (0, 0, np.radians(degrees))
        pose.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_set(2)
    assert bpy.ops.simod.write_frames(filepath=str(tmp_path / "f.ply"), start=1, end=3, wait=True) == {"FINISHED"}
    names = sorted(p.name for p in tmp_path.glob("*.ply"))
    assert names == ["f-0001.ply", "f-0002.ply", "f-0003.ply"] and (tmp_path / "p_s" / "binding.bin").exists()
    assert bpy.context.scene.frame_current == 2
    for frame in (1, 2, 3):
        bpy.context.scene.frame_set(frame)
        assert close(vertices(tmp_path / f"f-{frame:04}.ply"), by_blender(imported, vertices(model)))
    assert np.allclose(vertices(tmp_path / "f-0001.ply"), vertices(model), atol=1e-6)


def bump(points):
    """As a brush would: up to 0.1 along x, around a place."""
    distance = np.linalg.norm(points - [0.5, 1.2, 0], axis=1)
    t = np.clip(1 - (distance / 0.5) ** 2, 0, None)
    return points + (0.1 * t**3)[:, None] * [1, 0, 0]


def test_sculpted(imported, model, tmp_path):
    found = np.empty(3 * len(imported.data.vertices), np.float32)
    imported.data.vertices.foreach_get("co", found)
    imported.data.vertices.foreach_set("co", bump(found.reshape(-1, 3)).astype(np.float32).ravel())
    imported.data.update()
    after = write(tmp_path / "out.ply")
    assert close(after, bump(vertices(model))) and np.abs(after - vertices(model)).max() > 0.05
    expected = [line for line in sys.modules["simod_blender"].operators.last_report if "expected error" in line]
    assert expected and "vertices by" in " ".join(sys.modules["simod_blender"].operators.last_report)


def test_refine_keeps_the_edit(imported, model, tmp_path):
    pose = armature(imported)
    pose.rotation_euler = (0, 0, np.radians(40))
    imported.shape_key_add(name="Basis")
    wide = imported.shape_key_add(name="Wide")
    for v in wide.data:
        v.co.x *= 1.2
    wide.value = 1.0
    bpy.context.view_layer.update()
    before = np.array([v.co[:] for v in imported.data.vertices])
    for v in imported.data.vertices:
        v.select = abs(v.co.y - 1) < 0.2
    chosen = sum(v.select for v in imported.data.vertices)
    assert bpy.ops.simod.refine(factor=3.0, wait=True) == {"FINISHED"}
    mesh = imported.data
    assert len(mesh.vertices) > len(before) + chosen
    assert np.array_equal(np.array([v.co[:] for v in mesh.vertices])[: len(before)], before)
    added = np.array([v.co[:] for v in mesh.vertices])[len(before) :]
    assert (np.abs(added[:, 1] - 1) < 0.5).all()
    widened = np.array([v.co[:] for v in mesh.shape_keys.key_blocks["Wide"].data])
    assert np.allclose(widened[: len(before)], before * [1.2, 1, 1], atol=1e-6)
    assert np.allclose(widened, np.array([v.co[:] for v in mesh.vertices]) * [1.2, 1, 1], atol=2e-3)
    assert all(mesh.vertices[i].groups for i in range(len(before), len(mesh.vertices)))
    after = write(tmp_path / "out.ply")
    imported.shape_key_clear()
    expected = by_blender(imported, vertices(model) * [1.2, 1, 1])
    assert close(after, expected)


def test_other_vertices_are_refused_with_the_modifiers_name(imported, tmp_path):
    imported.modifiers.new("Fine", "SIMPLE_DEFORM")
    imported.modifiers.new("Too many", "SUBSURF")
    hidden = imported.modifiers.new("Hidden", "DECIMATE")
    hidden.show_viewport = False
    with pytest.raises(RuntimeError, match="the modifier Too many changes which vertices"):
        bpy.ops.simod.write_model(filepath=str(tmp_path / "out.ply"), wait=True)
    assert [m.show_viewport for m in imported.modifiers] == [True, True, False]
    imported.modifiers.clear()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    with pytest.raises(RuntimeError, match="itself has other vertices"):
        bpy.ops.simod.write_model(filepath=str(tmp_path / "out.ply"), wait=True)
    assert not (tmp_path / "out.ply").exists()


def test_what_the_program_refuses_is_told(imported, model, tmp_path):
    with pytest.raises(RuntimeError, match="is the model itself|would be overwritten"):
        bpy.ops.simod.write_model(filepath=str(model), wait=True)
    with pytest.raises(RuntimeError, match="no such file"):
        bpy.ops.simod.import_samples(filepath=str(tmp_path / "missing.ply"), wait=True)
    with pytest.raises(RuntimeError, match="no vertex is selected"):
        for v in imported.data.vertices:
            v.select = False
        bpy.ops.simod.refine(wait=True)


INSTALL = """
import sys, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable("bl_pkg")
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
assert "bl_ext.user_default.simod" in bpy.context.preferences.addons
bpy.context.preferences.addons["bl_ext.user_default.simod"].preferences.program = sys.argv[2]
bpy.ops.simod.import_samples(filepath=sys.argv[3], folder=sys.argv[4], preset="20000", wait=True)
print("imported", len(bpy.context.object.data.vertices))
"""


def test_blender_installs_the_zip(model, tmp_path):
    path = subprocess.check_output([sys.executable, HERE / "build.py", tmp_path], text=True).strip()
    command = [sys.executable, "-c", INSTALL, path, SIMOD, str(model), str(tmp_path / "p_s")]
    env = {key: value for key, value in os.environ.items() if key != "SIMOD_PROGRAM"}
    done = subprocess.run(command, capture_output=True, text=True, env={**env, "BLENDER_USER_RESOURCES": str(tmp_path)})
    assert "imported " in done.stdout, done.stdout + done.stderr


def test_the_lesson(extension, model, tmp_path):
    lesson = HERE.parent.parent / "examples" / "08-blender" / "armature.py"
    (tmp_path / "jar.ply").write_bytes(model.read_bytes())
    command = [sys.executable, lesson, tmp_path / "jar.ply", tmp_path / "bent.ply"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    before, after = vertices(model), vertices(tmp_path / "bent.ply")
    still, turned = before[:, 1] < 0.4, before[:, 1] > 1.6
    assert np.allclose(after[still], before[still], atol=1e-3)
    middle = (before[:, 1].min() + before[:, 1].max()) / 2
    c, s = np.cos(np.radians(35)), np.sin(np.radians(35))
    x, y, z = (before[turned] - [0, middle, 0]).T
    expected = np.stack([c * x - s * y, s * x + c * y + middle, z], 1)
    assert np.abs(after[turned] - expected).max() < 5e-3


def test_in_the_background_with_progress(extension, tmp_path, monkeypatch):
    operators = sys.modules["simod_blender"].operators
    # Large enough that each stage lasts until it is looked at.
    subprocess.run([SIMOD, "generate", "--vertices", "2000000", "-o", tmp_path / "large.ply"], check=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    how = {"folder": str(tmp_path / "p_s"), "preset": "0", "samples": 8000, "wait": True}
    assert bpy.ops.simod.import_samples(filepath=str(tmp_path / "large.ply"), **how) == {"FINISHED"}
    bpy.context.object.location.x = 1
    bpy.context.view_layer.update()
    # As with a window: the operator returns at once, and a timer looks at the job.
    monkeypatch.setattr(operators, "begin", lambda job, wait: setattr(operators, "current", job.start()))
    assert bpy.ops.simod.write_model(filepath=str(tmp_path / "out.ply")) == {"FINISHED"}
    with pytest.raises(RuntimeError, match="at work"):
        bpy.ops.simod.write_model(filepath=str(tmp_path / "other.ply"))
    seen = []
    while operators.look() is not None:
        seen.append((operators.current.stage, operators.current.fraction))
        time.sleep(0.002)
    assert all(0 <= part <= 1 for _, part in seen) and (tmp_path / "out.ply").exists()
    assert "reconstructing" in {stage for stage, _ in seen}
    assert operators.last_report[0].startswith("writing the model: done in")
    assert not bpy.ops.simod.cancel.poll()


def test_cancel(extension, tmp_path):
    big, out = tmp_path / "big.ply", tmp_path / "folder"
    jobs = sys.modules["simod_blender.jobs"]
    # As large as it has to be for the job to be seen at work.
    for vertices in (8_000_000, 32_000_000):
        subprocess.run([SIMOD, "generate", "--vertices", str(vertices), "-o", big], check=True)
        job = jobs.Job("sampling", [[SIMOD, "--json", "sample", str(big), "-o", str(out)]]).start()
        while job.fraction == 0 and not job.is_over:
            time.sleep(0.01)
        if not job.is_over:
            break
        job.close()
        shutil.rmtree(out)
    assert not job.is_over and job.stage in ("counting", "clustering")
    assert job.progress().startswith(job.stage)
    job.cancel()
    job.wait()
    job.close()
    assert job.error == "cancelled" and not out.exists() and not job.folder.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["big.ply"]


def test_georeferenced(extension, tmp_path):
    files = sys.modules["simod_blender.files"]
    # Far from zero, at two millimetres a step.
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 50, (20_000, 3)) + [400_000, 5_600_000, 100]
    points[:, 2] = 100 + np.sin(points[:, 0] / 8)
    files.write_ply(tmp_path / "far.ply", points)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.simod.import_samples(filepath=str(tmp_path / "far.ply"), preset="0", samples=3000, wait=True)
    object = bpy.context.object
    assert np.abs([v.co[:] for v in object.data.vertices]).max() < 60
    write(tmp_path / "same.ply")
    assert np.array_equal(vertices(tmp_path / "same.ply"), points)
    object.location.z = 5
    bpy.context.view_layer.update()
    assert np.abs(write(tmp_path / "up.ply") - points - [0, 0, 5]).max() < 1e-4
