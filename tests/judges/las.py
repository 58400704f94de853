"""LAS and LAZ through the program, judged by laspy with lazrs.

    python -m venv judges && judges/bin/pip install -r tests/judges/las-requirements.txt
    judges/bin/python tests/judges/las.py target/release/simod
    judges/bin/python tests/judges/las.py target/release/simod --measure 8000000

Every point format, compressed or not, with extra bytes, VLRs and EVLRs: an identity has to give the same file,
and a deformation the same of everything but positions, which have to be where PLY's are to half a step.
`--measure` compares the time of `sample` and `reconstruct` with that of reading and writing the file by laspy.
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

import copclib
import laspy
import numpy as np

import ply_files


def cloud(count, format, version, seed=1):
    """Hills with every dimension of the format filled."""
    random = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=format, version=version)
    header.scales, header.offsets = [0.001] * 3, [412_000.0, 5_318_000.0, 500.0]
    header.add_extra_dim(laspy.ExtraBytesParams("Reflectance", np.float32))
    header.add_extra_dim(laspy.ExtraBytesParams("Deviation", np.uint16))
    header.vlrs.append(laspy.VLR("nobody", 7, "unknown", b"kept as it is"))
    las = laspy.LasData(header)
    side = max(int(count**0.5), 1)
    index = np.arange(count)
    x, y = index % side + random.random(count), index // side + random.random(count)
    las.points = laspy.ScaleAwarePointRecord.zeros(count, header=header)
    las.x, las.y = 412_345.678 + 0.25 * x, 5_318_765.432 + 0.25 * y
    las.z = 512.3 + 20 * np.sin(0.01 * x) * np.cos(0.013 * y) + 0.02 * random.random(count)
    las.intensity = random.integers(0, 4000, count)
    las.Reflectance = random.random(count)
    las.Deviation = random.integers(0, 50, count)
    las.classification = random.integers(0, 7, count)
    las.return_number = np.ones(count, np.uint8)
    las.number_of_returns = np.ones(count, np.uint8)
    las.point_source_id = index // 100_000
    names = set(las.point_format.dimension_names)
    if "gps_time" in names:
        las.gps_time = 3e8 + index * 1e-5
    for name in ("red", "green", "blue", "nir"):
        if name in names:
            las[name] = random.integers(0, 65_535, count)
    if "wavepacket_offset" in names:
        las.wavepacket_offset = index * 100
    if version == "1.4":
        las.evlrs = laspy.vlrs.vlrlist.VLRList()
        las.evlrs.append(laspy.VLR("somebody", 9, "unknown", bytes(range(256)) * 300))
    return las


def simod(program, *words, folder):
    start = time.perf_counter()
    done = subprocess.run([program, *map(str, words)], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"simod {' '.join(map(str, words))}: {done.stderr}")
    return time.perf_counter() - start, done


def moved(p, middle):
    """Bends one half, and leaves the other."""
    u = np.maximum(p[:, 0] - middle, 0.0)
    return p + np.stack([0 * u, 0.05 * u, 0.002 * u * u], axis=1)


def move_samples(folder):
    data, start, points = ply_files.read(folder / "m.simod" / "samples.ply")
    p = np.stack([points[axis] for axis in "xyz"], axis=1)
    new = moved(p, p[:, 0].mean())
    for i, axis in enumerate("xyz"):
        points[axis] = new[:, i]
    ply_files.write(folder / "moved.ply", data, start, points)
    return p[:, 0].mean()


def compare(before, after, middle, what):
    old, new = laspy.read(before), laspy.read(after)
    assert old.header.point_count == new.header.point_count, what
    for name in old.point_format.dimension_names:
        if name not in ("X", "Y", "Z"):
            assert np.array_equal(old[name], new[name], equal_nan=old[name].dtype.kind == "f"), (what, name)
    was = np.stack([old.x, old.y, old.z], axis=1)
    there = np.stack([new.x, new.y, new.z], axis=1)
    still = was[:, 0] < middle - 20
    for axis in "XYZ":
        assert np.array_equal(old[axis][still], new[axis][still]), (what, axis, "moved")
    off = np.abs(there - moved(was, middle))[was[:, 0] > middle + 20].max()
    for i, axis in enumerate("XYZ"):
        scale, offset = old.header.scales[i], old.header.offsets[i]
        for name, least in (("mins", np.min), ("maxs", np.max)):
            was_told, told = getattr(old.header, name)[i], getattr(new.header, name)[i]
            # Bounds that are no points' stay where these do.
            if abs(was_told - (least(old[axis]) * scale + offset)) < 1e-6:
                assert abs(told - (least(new[axis]) * scale + offset)) < 1e-6, (what, axis, "bounds")
    def records(vlrs):
        return [(v.user_id, v.record_id, v.record_data_bytes()) for v in vlrs if v.user_id != "copc"]

    assert records(old.header.vlrs) == records(new.header.vlrs), what
    assert records(old.evlrs or []) == records(new.evlrs or []), what
    return off


def judge(program, count=60_000):
    formats = [(f, v) for v, all in (("1.2", range(4)), ("1.3", range(6)), ("1.4", range(11))) for f in all]
    for format, version in formats:
        for ending in ("las", "laz"):
            with tempfile.TemporaryDirectory() as name:
                folder, what = pathlib.Path(name), f"LAS {version}, point format {format}, {ending}"
                model, out = folder / f"m.{ending}", folder / f"out.{ending}"
                cloud(count, format, version).write(model)
                simod(program, "sample", model.name, "-o", "m.simod", "--samples", 4000, folder=folder)
                same = folder / "m.simod" / "samples.ply"
                simod(program, "reconstruct", "m.simod", "--deformed", same, "-o", out.name, folder=folder)
                assert out.read_bytes() == model.read_bytes(), (what, "identity")
                middle = move_samples(folder)
                line = ("reconstruct", "m.simod", "--deformed", "moved.ply", "-o", f"bent.{ending}")
                simod(program, *line, folder=folder)
                off = compare(model, folder / f"bent.{ending}", middle, what)
                print(f"{what}: off by {off:.4f} at most")


def judge_copc(program):
    """An octree with nodes of very different sizes, by copclib: all points stay, and nobody takes it for COPC."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        scale, offset = copclib.Vector3(0.001, 0.001, 0.001), copclib.Vector3(412_000.0, 5_318_000.0, 500.0)
        config = copclib.CopcConfigWriter(7, scale, offset, 'PROJCS["UTM32"]', copclib.EbVlr(0), False)
        writer = copclib.FileWriter(str(folder / "m.copc.laz"), config)
        random = np.random.default_rng(1)
        for key, count in (((0, 0, 0, 0), 80_000), ((1, 0, 0, 0), 500), ((1, 1, 0, 0), 7), ((2, 0, 0, 0), 30_000)):
            points = copclib.Points(writer.copc_config.las_header)
            for i, (u, v) in enumerate(random.random((count, 2)) * 100):
                point = points.CreatePoint()
                point.x, point.y, point.z = 412_345 + u, 5_318_765 + v, 510 + 3 * np.sin(0.1 * u)
                point.intensity, point.red, point.gps_time = i % 3000, i % 65_536, 1e8 + i
                points.AddPoint(point)
            writer.AddNode(copclib.VoxelKey(*key), points, copclib.VoxelKey(0, 0, 0, 0))
        writer.Close()
        simod(program, "sample", "m.copc.laz", "-o", "m.simod", "--samples", 4000, folder=folder)
        middle = move_samples(folder)
        simod(program, "reconstruct", "m.simod", "--deformed", "moved.ply", "-o", "bent.laz", folder=folder)
        off = compare(folder / "m.copc.laz", folder / "bent.laz", middle, "COPC")
        assert not any(vlr.user_id == "copc" for vlr in laspy.read(folder / "bent.laz").header.vlrs)
        print(f"COPC: off by {off:.4f} at most")


def measure(program, counts):
    """The best of three runs in turns: seconds, and seconds of processor time."""
    for count in counts:
        for format, version, ending in ((6, "1.4", "las"), (6, "1.4", "laz"), (3, "1.2", "laz")):
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                model = folder / f"m.{ending}"
                cloud(count, format, version).write(model)
                other = f"import laspy; laspy.read('m.{ending}').write('other.{ending}')"
                sample = ("sample", model.name, "-o", "m.simod", "--samples", 100_000, "--json")
                line = ("reconstruct", "m.simod", "--deformed", "moved.ply", "-o", f"out.{ending}", "--json")
                runs = {"laspy": [], "sample": [], "reconstruct": []}
                for _ in range(3):
                    for old in folder.glob("o*"):
                        old.unlink()
                    shutil.rmtree(folder / "m.simod", ignore_errors=True)
                    runs["laspy"].append(timed(sys.executable, "-c", other, folder=folder))
                    runs["sample"].append(timed(program, *sample, folder=folder))
                    move_samples(folder)
                    runs["reconstruct"].append(timed(program, *line, folder=folder))
                size = model.stat().st_size / 2**20
                print(f"{count} points of format {format}, {ending} of {size:.0f} MiB")
                best = {name: [min(all) for all in zip(*runs)] for name, runs in runs.items()}
                for name, (wall, cpu, peak) in best.items():
                    ratios = wall / best["laspy"][0], cpu / best["laspy"][1]
                    print(
                        f"  {name}: {wall:.2f} s ({ratios[0]:.2f} times laspy), {cpu:.2f} s of processor time "
                        f"({ratios[1]:.2f}), {peak:.0f} MiB",
                        flush=True,
                    )


def timed(*words, folder):
    """Seconds, seconds of processor time, and where the program tells it the peak of its memory in MiB."""
    start = time.perf_counter()
    process = subprocess.Popen([*map(str, words)], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    told = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, words
    peak = json.loads(told).get("peak_memory_bytes", 0) if told else 0
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, peak / 2**20


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--measure", type=int, nargs="+", metavar="POINTS")
    options = parser.parse_args()
    program = options.program.resolve()
    if options.measure:
        measure(program, options.measure)
    else:
        judge(program)
        judge_copc(program)
