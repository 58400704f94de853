"""Splats in packed layouts after a deformation, read and compared by numpy alone.

    python packed_splats.py SIMOD [SPLATS [SAMPLES]]

packs the scene of `splats.py` as `.splat`, as compressed PLY and as SPZ 2 by code of its own, and as SPZ 3 by `gsply` where
that is installed, has SIMOD deform all, reads them again likewise, and prints how far the splats are from those of the exact
map, beside how far the packing alone takes them.
"""

import gzip
import sys
import tempfile
from pathlib import Path

import numpy as np
import ply_files
import splats

try:
    import gsply
except ImportError:
    gsply = None

FIRST = 0.28209479177387814


def parts(values, bits):
    most = (1 << bits) - 1
    return np.clip(np.floor(values * most + 0.5), 0, most).astype(np.uint32)


def write_records(path, points):
    """As `.splat`."""
    out = np.zeros(len(points), [("p", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4)])
    out["p"] = splats.columns(points, "xyz")
    out["s"] = np.exp(splats.columns(points, [f"scale_{i}" for i in range(3)]))
    colours = splats.columns(points, [f"f_dc_{i}" for i in range(3)]) * FIRST + 0.5
    opacity = 1 / (1 + np.exp(-splats.columns(points, ["opacity"])))
    out["c"] = parts(np.hstack([colours, opacity]), 8)
    q = splats.columns(points, [f"rot_{i}" for i in range(4)])
    out["q"] = np.clip(np.round(q / np.linalg.norm(q, axis=1)[:, None] * 128 + 128), 0, 255)
    path.write_bytes(out.tobytes())


def read_records(path):
    data = np.frombuffer(path.read_bytes(), [("p", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4)])
    return data["p"].astype(float), np.log(data["s"].astype(float)), (data["q"].astype(float) - 128) / 128


def packed_three(values, low, high):
    t = parts((values - low) / (high - low), 11)
    t[:, 1] = parts((values - low) / (high - low), 10)[:, 1]
    return t[:, 0] << 21 | t[:, 1] << 11 | t[:, 2]


def three(words, low, high):
    t = np.stack([(words >> 21) / 2047, (words >> 11 & 1023) / 1023, (words & 2047) / 2047], 1)
    return low + (high - low) * t


NAMES = [f"{side}_{g}{axis}" for g in ("", "scale_") for side in ("min", "max") for axis in "xyz"]


def write_chunks(path, points):
    """As compressed PLY, without bounds of colours; splats in the order of the scene."""
    count = len(points)
    chunk = np.arange(count) // 256
    starts = np.arange(0, count, 256)
    p = splats.columns(points, "xyz")
    s = splats.columns(points, [f"scale_{i}" for i in range(3)])
    bounds = [f.reduceat(v, starts).astype(np.float32) for v in (p, s) for f in (np.minimum, np.maximum)]
    q = splats.columns(points, [f"rot_{i}" for i in range(4)])
    q /= np.linalg.norm(q, axis=1)[:, None]
    largest = np.abs(q).argmax(1)
    q *= np.sign(np.take_along_axis(q, largest[:, None], 1))
    others = q[np.arange(4) != largest[:, None]].reshape(-1, 3)
    r = parts(others * np.sqrt(0.5) + 0.5, 10)
    out = np.zeros(count, [(n, "<u4") for n in ("p", "r", "s", "c")])
    out["p"] = packed_three(p, bounds[0][chunk], bounds[1][chunk])
    out["r"] = largest.astype(np.uint32) << 30 | r[:, 0] << 20 | r[:, 1] << 10 | r[:, 2]
    out["s"] = packed_three(s, bounds[2][chunk], bounds[3][chunk])
    out["c"] = 0x80808000 | parts(1 / (1 + np.exp(-points["opacity"].astype(float))), 8)
    rest = sum(name.startswith("f_rest_") for name in points.dtype.names)
    harmonics = splats.columns(points, [f"f_rest_{i}" for i in range(rest)])
    harmonics = np.clip(np.trunc((harmonics / 8 + 0.5) * 256), 0, 255).astype(np.uint8)
    header = f"ply\nformat binary_little_endian 1.0\nelement chunk {len(starts)}\n"
    header += "".join(f"property float {name}\n" for name in NAMES) + f"element vertex {count}\n"
    header += "".join(f"property uint packed_{name}\n" for name in ("position", "rotation", "scale", "color"))
    header += f"element sh {count}\n" + "".join(f"property uchar f_rest_{i}\n" for i in range(rest))
    bounds = np.hstack(bounds).astype("<f4")
    path.write_bytes((header + "end_header\n").encode() + bounds.tobytes() + out.tobytes() + harmonics.tobytes())


def read_chunks(path):
    data = path.read_bytes()
    start = data.index(ply_files.END) + len(ply_files.END)
    count = int(data[:start].split(b"element vertex ")[1].split(b"\n")[0])
    chunks = -(-count // 256)
    bounds = np.frombuffer(data, "<f4", 12 * chunks, start).reshape(-1, 12).astype(float)
    words = np.frombuffer(data, "<u4", 4 * count, start + 48 * chunks).reshape(-1, 4).astype(np.uint64)
    b = bounds[np.arange(count) // 256]
    r = words[:, 1]
    others = np.stack([(r >> 20 & 1023), (r >> 10 & 1023), (r & 1023)], 1) / 1023 - 0.5
    others *= np.sqrt(2)
    q = np.zeros((count, 4))
    largest = (r >> 30).astype(int)
    q[np.arange(4) != largest[:, None]] = others.ravel()
    q[np.arange(count), largest] = np.sqrt(np.maximum(0, 1 - (others**2).sum(1)))
    return three(words[:, 0], b[:, 0:3], b[:, 3:6]), three(words[:, 2], b[:, 6:9], b[:, 9:12]), q


def write_spz(path, points):
    """As SPZ 2, with harmonics."""
    count = len(points)
    p = np.round(splats.columns(points, "xyz") * 4096).astype("<i4")
    p = p.view("u1").reshape(count, 3, 4)[:, :, :3]
    opacity = parts(1 / (1 + np.exp(-splats.columns(points, ["opacity"]))), 8)
    colours = splats.columns(points, [f"f_dc_{i}" for i in range(3)]) * 0.15 * 255 + 127.5
    scales = (splats.columns(points, [f"scale_{i}" for i in range(3)]) + 10) * 16
    q = splats.columns(points, [f"rot_{i}" for i in (1, 2, 3, 0)])
    q /= np.linalg.norm(q, axis=1)[:, None] * np.where(q[:, 3] < 0, -1, 1)[:, None]
    rest = sum(name.startswith("f_rest_") for name in points.dtype.names)
    harmonics = splats.columns(points, [f"f_rest_{c * rest // 3 + k}" for k in range(rest // 3) for c in range(3)])
    header = np.array([0x5053474E, 2, count], "<u4").tobytes()
    header += bytes([{0: 0, 9: 1, 24: 2, 45: 3}[rest], 12, 0, 0])
    arrays = [opacity, colours, scales, (q[:, :3] + 1) * 127.5, harmonics * 128 + 128]
    data = p.tobytes() + b"".join(np.clip(np.round(a), 0, 255).astype("u1").tobytes() for a in arrays)
    path.write_bytes(gzip.compress(header + data, 6))


def read_spz(path):
    data = gzip.decompress(path.read_bytes())
    count = int(np.frombuffer(data, "<u4", 1, 8)[0])
    p = np.frombuffer(data, "u1", 9 * count, 16).reshape(count, 3, 3).astype(np.int64)
    p = p[:, :, 0] | p[:, :, 1] << 8 | p[:, :, 2] << 16
    p = (p ^ 1 << 23) - (1 << 23)
    at = 16 + 13 * count
    scales = np.frombuffer(data, "u1", 3 * count, at).reshape(-1, 3) / 16 - 10
    q = np.frombuffer(data, "u1", 3 * count, at + 3 * count).reshape(-1, 3) / 127.5 - 1
    w = np.sqrt(np.maximum(0, 1 - (q**2).sum(1)))
    return p / 4096, scales, np.column_stack([w, q])


def write_spz_3(path, points):
    """As SPZ 3, by gsply."""
    rest = sum(name.startswith("f_rest_") for name in points.dtype.names)
    harmonics = splats.columns(points, [f"f_rest_{i}" for i in range(rest)]).reshape(len(points), 3, rest // 3)
    q = splats.columns(points, [f"rot_{i}" for i in range(4)])
    numbers = {
        "means": splats.columns(points, "xyz"),
        "scales": splats.columns(points, [f"scale_{i}" for i in range(3)]),
        "quats": q / np.linalg.norm(q, axis=1)[:, None],
        "opacities": points["opacity"],
        "sh0": splats.columns(points, [f"f_dc_{i}" for i in range(3)]),
        "shN": harmonics.transpose(0, 2, 1),
    }
    data = gsply.GSData(**{name: np.ascontiguousarray(array, "<f4") for name, array in numbers.items()})
    gsply.write_spz(path, data, version=3)


def read_spz_3(path):
    data = gsply.read_spz(path)
    return data.means.astype(float), data.scales.astype(float), data.quats.astype(float)


def covariances(scales, q):
    points = np.zeros(len(q), [(n, "f8") for n in [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]])
    for i in range(3):
        points[f"scale_{i}"] = scales[:, i]
    for i in range(4):
        points[f"rot_{i}"] = q[:, i]
    return splats.covariances(points)


def main():
    simod = sys.argv[1]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 300_000
    samples = int(sys.argv[3]) if len(sys.argv) > 3 else 50_000
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        splats.scene(folder / "scene.ply", count, 1)
        points = ply_files.vertices(folder / "scene.ply")
        # Neighbours in space side by side, as packers have them.
        p = splats.columns(points, "xyz")
        cells = np.floor((p - p.min(0)) / 0.05).astype(int)
        points = points[np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))]
        layouts = (
            ("m.splat", write_records, read_records),
            ("m.ply", write_chunks, read_chunks),
            ("m.spz", write_spz, read_spz),
            ("m3.spz", write_spz_3, read_spz_3),
        )
        if gsply is None:
            layouts = layouts[:-1]
            print("SPZ 3 is left out, as there is no gsply")
        for name, write, read in layouts:
            write(folder / name, points)
            splats.run([simod, "sample", folder / name, "-o", folder / f"s-{name}", "--samples", samples])
            p, s, q = read(folder / name)
            packed = covariances(s, q)
            for map_ in splats.rigid, splats.twist:
                out = folder / ("o." + name.split(".")[1])
                out.unlink(missing_ok=True)
                data, start, moved = ply_files.read(folder / f"s-{name}" / "samples.ply")
                splats.put(moved, "xyz", map_(splats.columns(moved, "xyz"))[0])
                ply_files.write(folder / "d.ply", data, start, moved)
                splats.run([simod, "reconstruct", folder / f"s-{name}", "--deformed", folder / "d.ply", "-o", out])
                image, j = map_(p)
                sigma = j @ packed @ j.transpose(0, 2, 1)
                found, fs, fq = read(out)
                off = splats.size(covariances(fs, fq) - sigma) / splats.size(sigma)
                # What packing does to the model itself.
                before = splats.covariances(points)
                lost = splats.size(packed - before) / splats.size(before)
                centres = np.linalg.norm(found - image, axis=1)
                print(
                    f"{name:8} {map_.__name__:6} centres {centres.max():.1e} | covariance rms {splats.rms(off):.1e} "
                    f"p99.9 {np.quantile(off, 0.999):.1e}, by packing alone rms {splats.rms(lost):.1e} "
                    f"p99.9 {np.quantile(lost, 0.999):.1e}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
