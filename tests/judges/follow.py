"""Numbers that are declared to turn with the surface, in every format that has names for them: PLY, PCD, CSV, LAS and LAZ.

    python -m venv judges && judges/bin/pip install -r tests/judges/las-requirements.txt
    judges/bin/python tests/judges/follow.py SIMOD [POINTS [SAMPLES]]

makes a cloud on a bumpy torus with a vector, a normal, a quaternion and a covariance at each point, has SIMOD sample it
and reconstruct it with samples that are twisted here, and compares with the exact Jacobian of the twist. In LAS the
numbers are extra bytes, the normal's of 16 bits with a scale; what they say of their least and largest has to be true.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import laspy
import numpy as np
import ply_files
from splats import columns, put, quaternions, rotations, torus, twist

RNG = np.random.default_rng(11)
VECTOR = ["v_x", "v_y", "v_z"]
NORMAL = ["sideX", "sideY", "sideZ"]
QUATERNION = ["q_w", "q_x", "q_y", "q_z"]
COVARIANCE = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"]
TURNS = VECTOR + NORMAL + QUATERNION + COVARIANCE
FOLLOW = "v=vector,side=normal,q=quaternion-wxyz,cov=covariance"
STEP = 1 / 32000


def cloud(count):
    p, n = torus(count)
    points = np.zeros(count, [(name, "<f8") for name in ["x", "y", "z", *TURNS, "kept"]])
    put(points, "xyz", p)
    put(points, VECTOR, RNG.normal(size=(count, 3)))
    put(points, NORMAL, n)
    put(points, QUATERNION, quaternions(rotations(RNG.normal(size=(count, 3)))))
    half = RNG.normal(size=(count, 3, 3)) * 0.01
    sigma = half @ half.transpose(0, 2, 1)
    put(points, COVARIANCE, sigma[:, *np.triu_indices(3)])
    points["kept"] = np.arange(count)
    return points


def write(points, path):
    if path.suffix == ".csv":
        np.savetxt(path, points, "%.9g", ",", header=",".join(points.dtype.names), comments="")
    elif path.suffix in (".las", ".laz"):
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = [1e-7] * 3
        for name in [*TURNS, "kept"]:
            scaled = {"scales": np.array([STEP]), "offsets": np.array([0.0])} if name in NORMAL else {}
            kind = np.int16 if name in NORMAL else np.float32 if name in VECTOR else np.float64
            header.add_extra_dim(laspy.ExtraBytesParams(name, kind, **scaled))
        las = laspy.LasData(header)
        las.points = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
        las.x, las.y, las.z = points["x"], points["y"], points["z"]
        for name in [*TURNS, "kept"]:
            las[name] = points[name]
        las.write(path)
        limit(path)
    else:
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property double {name}\n" for name in points.dtype.names) + "end_header\n"
        path.write_bytes(head.encode() + points.tobytes())


def descriptions(path):
    """The bytes of a file, and of each dimension of extra bytes its name and where it is described."""
    data = bytearray(path.read_bytes())
    at = int(np.frombuffer(data, "<u2", 1, 94)[0])
    for _ in range(int(np.frombuffer(data, "<u4", 1, 100)[0])):
        user, number, length = bytes(data[at + 2 : at + 18]).rstrip(b"\0"), *np.frombuffer(data, "<u2", 2, at + 18)
        content, at = at + 54, at + 54 + int(length)
        if (user, number) == (b"LASF_Spec", 4):
            places = range(content, at, 192)
            return data, [(bytes(data[p + 4 : p + 36]).rstrip(b"\0").decode(), p) for p in places]


def reach(las, name):
    """The least and the largest number, as bytes, in the way of a description."""
    numbers = np.asarray(las[name])
    numbers, kind = (np.round(numbers / STEP), "<i8") if name in NORMAL else (numbers, "<f8")
    return [np.array([f(numbers)], kind).tobytes() for f in (np.min, np.max)]


def limit(path):
    """Has the descriptions say how far numbers reach."""
    las, (data, places) = laspy.read(path), descriptions(path)
    for name, at in places:
        data[at + 3] |= 6
        data[at + 64 : at + 72], data[at + 88 : at + 96] = reach(las, name)
    path.write_bytes(data)


def check_limits(las, path):
    data, places = descriptions(path)
    for name, at in places:
        assert [data[at + 64 : at + 72], data[at + 88 : at + 96]] == reach(las, name), name


def read(path, simod):
    if path.suffix == ".csv":
        return np.genfromtxt(path, delimiter=",", names=True, deletechars="", dtype=float)
    if path.suffix in (".las", ".laz"):
        las = laspy.read(path)
        check_limits(las, path)
        points = np.zeros(len(las), [(name, "<f8") for name in ["x", "y", "z", *TURNS, "kept"]])
        for name in points.dtype.names:
            points[name] = las[name]
        return points
    if path.suffix == ".pcd":
        run([simod, "convert", path, path.with_suffix(".back.ply")])
        path = path.with_suffix(".back.ply")
    return ply_files.vertices(path)


def symmetric(points):
    m = np.zeros((len(points), 3, 3))
    for name in COVARIANCE:
        i, j = ("xyz".index(letter) for letter in name[-2:])
        m[:, i, j] = m[:, j, i] = points[name]
    return m


def off(rest, found):
    """How far each kind is off, relative to its size: rms, and what 99.9 % are below."""
    image, j = twist(columns(rest, "xyz"))
    assert np.array_equal(found["kept"], rest["kept"])
    vector = np.einsum("nij,nj->ni", j, columns(rest, VECTOR))
    normal = np.einsum("nij,nj->ni", np.linalg.inv(j).transpose(0, 2, 1), columns(rest, NORMAL))
    normal *= np.linalg.norm(columns(rest, NORMAL), axis=1)[:, None] / np.linalg.norm(normal, axis=1)[:, None]
    u, _, vt = np.linalg.svd(j)
    w, x, y, z = columns(rest, QUATERNION).T
    a = quaternions(u @ vt).T
    turned = np.stack(
        [
            a[0] * w - a[1] * x - a[2] * y - a[3] * z,
            a[0] * x + a[1] * w + a[2] * z - a[3] * y,
            a[0] * y - a[1] * z + a[2] * w + a[3] * x,
            a[0] * z + a[1] * y - a[2] * x + a[3] * w,
        ],
        1,
    )
    quaternion = columns(found, QUATERNION)
    turned *= np.sign((turned * quaternion).sum(1))[:, None]
    sigma = j @ symmetric(rest) @ j.transpose(0, 2, 1)
    for name, expected, values in [
        ("position", image, columns(found, "xyz")),
        ("vector", vector, columns(found, VECTOR)),
        ("normal", normal, columns(found, NORMAL)),
        ("quaternion", turned, quaternion),
        ("covariance", sigma.reshape(-1, 9), symmetric(found).reshape(-1, 9)),
    ]:
        error = np.linalg.norm(values - expected, axis=1) / np.linalg.norm(expected, axis=1)
        yield name, np.sqrt((error**2).mean()), np.quantile(error, 0.999)


def run(command):
    subprocess.run(command, check=True, capture_output=True)


def main():
    simod, count, samples = sys.argv[1], *(int(n) for n in [*sys.argv[2:], 300_000, 50_000][:2])
    points = cloud(count)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for suffix in ["ply", "pcd", "csv", "las", "laz"]:
            model, out, sampled = folder / f"model.{suffix}", folder / f"out.{suffix}", folder / f"{suffix}.simod"
            if suffix == "pcd":
                run([simod, "convert", folder / "model.ply", model])
            else:
                write(points, model)
            rest = read(model, simod)
            run([simod, "sample", model, "-o", sampled, "--samples", str(samples)])
            data, start, p = ply_files.read(sampled / "samples.ply")
            put(p, "xyz", twist(columns(p, "xyz"))[0])
            ply_files.write(folder / "deformed.ply", data, start, p)
            deformed = ["--deformed", folder / "deformed.ply", "--follow", FOLLOW]
            run([simod, "reconstruct", sampled, *deformed, "-o", out])
            for name, rms, most in off(rest, read(out, simod)):
                print(f"{suffix}  {name:10}  rms {rms:.1e}  of 99.9 % below {most:.1e}")


if __name__ == "__main__":
    main()
