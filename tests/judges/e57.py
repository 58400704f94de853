"""E57 through the program, judged by pye57, which has libE57Format inside.

    python -m venv judges && judges/bin/pip install -r tests/judges/e57-requirements.txt
    judges/bin/python tests/judges/e57.py target/release/simod
    judges/bin/python tests/judges/e57.py target/release/simod --measure 8000000
    judges/bin/python tests/judges/e57.py target/release/simod --file SCANS.e57

Files of several scans with poses, in floats, doubles and integers, cartesian and spherical, with colours, invalid points,
an image and an extension: an identity has to give the same file, and a deformation the same of everything but positions,
which have to be where they are told to be, in the frame that the scans share. `--measure` compares the time of `sample`
and `reconstruct` with that of reading and writing the file by pye57. `--file` judges a file of your own.
"""

import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import numpy as np
import pye57
from pye57 import libe57
from pyquaternion import Quaternion

import ply_files

CARTESIAN = ["cartesianX", "cartesianY", "cartesianZ"]
SPHERICAL = ["sphericalRange", "sphericalAzimuth", "sphericalElevation"]
IMAGE = bytes(range(256)) * 77


def hills(count, seed):
    """Points of a surface, in the common frame."""
    random = np.random.default_rng(seed)
    side = max(int(count**0.5), 1)
    index = np.arange(count)
    x, y = 0.05 * (index % side + random.random(count)), 0.05 * (index // side + random.random(count))
    return np.stack([x, y, np.sin(0.5 * x) * np.cos(0.4 * y) + 0.002 * random.random(count)], axis=1)


def spherical(p):
    flat = np.hypot(p[:, 0], p[:, 1])
    return np.stack([np.hypot(flat, p[:, 2]), np.arctan2(p[:, 1], p[:, 0]), np.arctan2(p[:, 2], flat)], axis=1)


def cartesian(s):
    r, a, e = s.T
    return np.stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)], axis=1)


def write(path, count, kinds):
    """A file with a scan of each kind."""
    file = pye57.E57(str(path), mode="w")
    imf = file.image_file
    imf.extensionsAdd("ext", "https://example.org/extension")
    file.root.set("ext:note", libe57.StringNode(imf, "kept as it is"))
    random = np.random.default_rng(7)
    for number, kind in enumerate(kinds):
        rotation = Quaternion(axis=[0.2 * number, 0.1, 1.0], angle=0.7 * number)
        translation = np.array([412_345.5, 5_318_765.25, 12.0]) + 3.0 * number
        common = hills(count, number) + [412_340.0 + 2 * number, 5_318_760.0, 10.0]
        local = (rotation.rotation_matrix.T @ (common - translation).T).T
        names = SPHERICAL if kind.startswith("spherical") else CARTESIAN
        numbers = spherical(local) if names is SPHERICAL else local
        scan, prototype, buffers = libe57.StructureNode(imf), libe57.StructureNode(imf), libe57.VectorSourceDestBuffer()
        held = []

        def field(name, node, values):
            prototype.set(name, node)
            held.append(np.ascontiguousarray(values))
            buffers.append(libe57.SourceDestBuffer(imf, name, held[-1], count, True, True))

        rows = np.arange(count) % 1000
        field("rowIndex", libe57.IntegerNode(imf, 0, 0, 999), rows.astype(np.int16))
        for i, name in enumerate(names):
            values = numbers[:, i].astype(np.float64)
            if kind.endswith("single"):
                node = libe57.FloatNode(imf, float(np.float32(values[0])), libe57.E57_SINGLE)
                values = values.astype(np.float32)
            elif kind.endswith("double"):
                node = libe57.FloatNode(imf, values[0], libe57.E57_DOUBLE, values.min(), values.max())
            else:
                scale = 1e-6 if names is SPHERICAL and i > 0 else 0.0001
                least = int((values.min() - 0.25) / scale) - 30_000
                most = int((values.max() - 0.25) / scale) + 31_234 * (i + 1)
                node = libe57.ScaledIntegerNode(imf, least, least, most, scale, 0.25)
            field(name, node, values)
            if i == 1:
                # In between, so that bits of one field are not beside those of another.
                field("intensity", libe57.FloatNode(imf, 0, libe57.E57_SINGLE, 0, 1), random.random(count, np.float32))
        state = "sphericalInvalidState" if names is SPHERICAL else "cartesianInvalidState"
        if number % 2 == 1:
            states = (np.arange(count) % 17 == 5).astype(np.int8) * 2
            field(state, libe57.IntegerNode(imf, 0, 0, 2), states)
        for channel in ("colorRed", "colorGreen", "colorBlue"):
            field(channel, libe57.IntegerNode(imf, 0, 0, 255), random.integers(0, 256, count).astype(np.uint8))
        field("ext:class", libe57.IntegerNode(imf, -3, -3, 40), random.integers(-3, 41, count).astype(np.int8))
        scan.set("guid", libe57.StringNode(imf, f"{{{number}}}"))
        scan.set("name", libe57.StringNode(imf, f"{kind}, number {number}"))
        pose, turn, place = (libe57.StructureNode(imf) for _ in range(3))
        for name, value in zip("wxyz", rotation.elements):
            turn.set(name, libe57.FloatNode(imf, value))
        for name, value in zip("xyz", translation):
            place.set(name, libe57.FloatNode(imf, value))
        pose.set("rotation", turn)
        pose.set("translation", place)
        scan.set("pose", pose)
        valid = states == 0 if number % 2 == 1 else np.ones(count, bool)
        bounds(imf, scan, "cartesianBounds", local[valid], ["x", "y", "z"], ("Minimum", "Maximum"))
        if names is SPHERICAL:
            box = libe57.StructureNode(imf)
            for i, (least, most) in enumerate((("rangeMinimum", "rangeMaximum"), ("azimuthStart", "azimuthEnd"),
                                               ("elevationMinimum", "elevationMaximum"))):
                box.set(least, libe57.FloatNode(imf, numbers[valid, i].min()))
                box.set(most, libe57.FloatNode(imf, numbers[valid, i].max()))
            scan.set("sphericalBounds", box)
        points = libe57.CompressedVectorNode(imf, prototype, libe57.VectorNode(imf, True))
        scan.set("points", points)
        file.data3d.append(scan)
        writer = points.writer(buffers)
        writer.write(count)
        writer.close()
        if number == 0:
            image, shown = libe57.StructureNode(imf), libe57.StructureNode(imf)
            image.set("guid", libe57.StringNode(imf, "{image}"))
            file.root["images2D"].append(image)
            image.set("visualReferenceRepresentation", shown)
            blob = libe57.BlobNode(imf, len(IMAGE))
            shown.set("jpegImage", blob)
            blob.write(np.frombuffer(IMAGE, np.uint8).copy(), 0, len(IMAGE))
    file.close()


def bounds(imf, scan, name, points, axes, ends):
    box = libe57.StructureNode(imf)
    for i, axis in enumerate(axes):
        box.set(axis + ends[0], libe57.FloatNode(imf, points[:, i].min()))
        box.set(axis + ends[1], libe57.FloatNode(imf, points[:, i].max()))
    scan.set(name, box)


def read(path):
    """Every field of every scan as it is stored, and as numbers; poses, bounds, and the tree of all else."""
    file = pye57.E57(str(path))
    imf, scans = file.image_file, []
    for index in range(file.scan_count):
        header = file.get_header(index)
        raw, numbers, buffers = {}, {}, libe57.VectorSourceDestBuffer()
        prototype = libe57.StructureNode(header.points.prototype())
        fields = [prototype[i] for i in range(len(prototype))]
        for field in fields:
            name = field.elementName()
            scaled = isinstance(field, libe57.ScaledIntegerNode)
            kind = np.longlong if isinstance(field, libe57.IntegerNode) or scaled else np.float64
            raw[name] = np.empty(header.point_count, kind)
            buffers.append(libe57.SourceDestBuffer(imf, name, raw[name], header.point_count, True, False))
        reader = header.points.reader(buffers)
        assert reader.read() == header.point_count
        reader.close()
        for field in fields:
            name = field.elementName()
            numbers[name] = raw[name].astype(np.float64)
            if isinstance(field, libe57.ScaledIntegerNode):
                numbers[name] = numbers[name] * field.scale() + field.offset()
        names = CARTESIAN if CARTESIAN[0] in numbers else SPHERICAL
        local = np.stack([numbers[name] for name in names], axis=1)
        local = local if names is CARTESIAN else cartesian(local)
        state = names[0].split("X")[0].split("R")[0] + "InvalidState"
        valid = raw[state] == 0 if state in raw else np.ones(len(local), bool)
        matrix = Quaternion(header.rotation).rotation_matrix if header.has_pose() else np.eye(3)
        translation = header.translation if header.has_pose() else np.zeros(3)
        step = [max(f.scale(), 1e-12) if isinstance(f, libe57.ScaledIntegerNode) else 0.0 for f in fields if f.elementName() in names]
        scans.append({
            "raw": raw, "numbers": numbers, "names": names, "valid": valid, "local": local,
            "common": (matrix @ local.T).T + translation, "step": step, "points": header.points,
            "single": any(isinstance(f, libe57.FloatNode) and f.precision() == libe57.E57_SINGLE for f in fields if f.elementName() in names),
            "scan": file.data3d[index],
        })
    others = {}
    describe(file.root, "", others)
    return file, scans, others


def describe(node, path, to):
    """What the tree says, but for points."""
    if isinstance(node, libe57.StructureNode) or isinstance(node, libe57.VectorNode):
        for i in range(len(node)):
            describe(node[i], f"{path}/{node[i].elementName()}", to)
    elif isinstance(node, libe57.BlobNode):
        content = np.zeros(node.byteCount(), np.uint8)
        node.read(content, 0, node.byteCount())
        to[path] = content.tobytes()
    elif isinstance(node, libe57.ScaledIntegerNode):
        to[path] = node.rawValue()
    elif not isinstance(node, libe57.CompressedVectorNode):
        to[path] = node.value()


def simod(program, *words, folder):
    done = subprocess.run([program, *map(str, words)], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"simod {' '.join(map(str, words))}: {done.stderr}")
    return done


def moved(p, middle):
    """Bends one half, and leaves the other."""
    u = np.maximum(p[:, 0] - middle, 0.0)
    return p + np.stack([0 * u, 0.01 * u, 0.001 * u * u], axis=1)


def move_samples(folder):
    data, start, points = ply_files.read(folder / "m.simod" / "samples.ply")
    p = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    middle = p[:, 0].mean()
    new = moved(p, middle)
    for i, axis in enumerate("xyz"):
        points[axis] = new[:, i]
    ply_files.write(folder / "moved.ply", data, start, points)
    return middle


def compare(before, after, middle, margin, what):
    old_file, old, others = read(before)
    new_file, new, new_others = read(after)
    assert len(old) == len(new), what
    for path, value in others.items():
        is_bound = "artesianBounds" in path or "phericalBounds" in path
        assert path in new_others and (is_bound or value == new_others[path] or value != value), (what, path)
    off = 0.0
    for number, (a, b) in enumerate(zip(old, new)):
        for name, values in a["raw"].items():
            if name in a["names"]:
                same = ~a["valid"] | (a["common"][:, 0] < middle - margin)
                assert np.array_equal(values[same], b["raw"][name][same]), (what, number, name, "moved")
            else:
                assert np.array_equal(values, b["raw"][name], equal_nan=values.dtype.kind == "f"), (what, number, name)
        wanted = moved(a["common"], middle)
        here = a["valid"] & (a["common"][:, 0] > middle + margin)
        if here.any():
            off = max(off, np.abs(b["common"] - wanted)[here].max())
        for name, points, corners in (("cartesianBounds", "local", [f"{x}{m}" for x in "xyz" for m in ("Minimum", "Maximum")]),):
            if not (a["scan"].isDefined(name) and b["scan"].isDefined(name)):
                continue
            for i, corner in enumerate(corners):
                of = np.min if i % 2 == 0 else np.max
                was, now = (of(s[points][s["valid"]][:, i // 2]) for s in (a, b))
                told_was, told = (s["scan"][name][corner].value() for s in (a, b))
                # Where the points did not say so before, the text stays as long as they do.
                if was != now or abs(told_was - was) < 1e-9:
                    assert abs(told - now) < 1e-5 * max(1, abs(now)), (what, number, corner, told, now)
    for file in (old_file, new_file):
        file.close()
    return off


def judge_file(program, model, folder, what, bound):
    simod(program, "info", model.name, folder=folder)
    simod(program, "sample", model.name, "-o", "m.simod", "--samples", 4000, folder=folder)
    same = folder / "m.simod" / "samples.ply"
    simod(program, "reconstruct", "m.simod", "--deformed", same, "-o", "same.e57", folder=folder)
    assert (folder / "same.e57").read_bytes() == model.read_bytes(), (what, "identity")
    middle = move_samples(folder)
    simod(program, "reconstruct", "m.simod", "--deformed", "moved.ply", "-o", "bent.e57", folder=folder)
    points = ply_files.vertices(same)
    # So far from the bend, samples on one side of it alone have a say.
    margin = 10 * np.ptp(points["x"]) / len(points) ** 0.5
    off = compare(model, folder / "bent.e57", middle, margin, what)
    assert off < bound, (what, off)
    print(f"{what}: off by {off:.6f} at most", flush=True)


def judge(program):
    kinds = ("cartesian double", "cartesian integer", "spherical single", "spherical double", "spherical integer", "cartesian single")
    for count in (50, 30_000, 150_000):
        for some in ([kind] for kind in kinds):
            run(program, count, some)
        run(program, count, kinds)


def run(program, count, kinds):
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        write(folder / "m.e57", count, kinds)
        judge_file(program, folder / "m.e57", folder, f"{count} points each, {' and '.join(kinds)}", 0.01)


def measure(program, counts):
    """The best of three runs in turns: seconds, seconds of processor time, and the peak of memory."""
    other = (
        "import pye57\na = pye57.E57('m.e57')\nb = pye57.E57('other.e57', mode='w')\n"
        "for i in range(a.scan_count):\n    raw, head = a.read_scan_raw(i, ignore_unsupported_fields=True), a.get_header(i)\n"
        "    b.write_scan_raw(raw, name=str(i), rotation=head.rotation, translation=head.translation)\n"
        "b.close()"
    )
    for count in counts:
        for kind in ("cartesian single", "cartesian integer"):
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                model = folder / "m.e57"
                write(model, count // 2, (kind, kind))
                sample = ("sample", model.name, "-o", "m.simod", "--samples", 100_000, "--json")
                line = ("reconstruct", "m.simod", "--deformed", "moved.ply", "-o", "out.e57", "--json")
                runs = {"pye57": [], "sample": [], "reconstruct": []}
                for _ in range(3):
                    for old in folder.glob("o*"):
                        old.unlink()
                    shutil.rmtree(folder / "m.simod", ignore_errors=True)
                    runs["pye57"].append(timed(sys.executable, "-c", other, folder=folder))
                    runs["sample"].append(timed(program, *sample, folder=folder))
                    move_samples(folder)
                    runs["reconstruct"].append(timed(program, *line, folder=folder))
                print(f"{count} points, {kind}, {model.stat().st_size / 2**20:.0f} MiB")
                best = {name: [min(all) for all in zip(*runs)] for name, runs in runs.items()}
                for name, (wall, cpu, peak) in best.items():
                    ratios = wall / best["pye57"][0], cpu / best["pye57"][1]
                    print(f"  {name}: {wall:.2f} s ({ratios[0]:.2f} times pye57), {cpu:.2f} s of processor time "
                          f"({ratios[1]:.2f}), {peak:.0f} MiB", flush=True)


def timed(*words, folder):
    """Seconds, seconds of processor time, and the peak of memory in MiB."""
    start = time.perf_counter()
    process = subprocess.Popen([*map(str, words)], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    told = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, words
    peak = json.loads(told).get("peak_memory_bytes") if told else None
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, (peak or usage.ru_maxrss * 1024) / 2**20


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--measure", type=int, nargs="+", metavar="POINTS")
    parser.add_argument("--file", type=pathlib.Path)
    options = parser.parse_args()
    program = options.program.resolve()
    if options.measure:
        measure(program, options.measure)
    elif options.file:
        with tempfile.TemporaryDirectory() as name:
            copy = pathlib.Path(name) / "m.e57"
            shutil.copy(options.file, copy)
            judge_file(program, copy, pathlib.Path(name), options.file.name, np.inf)
    else:
        judge(program)
