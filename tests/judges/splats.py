"""Gaussian splats after deformations, compared with what numpy makes of the same maps and their exact Jacobians.

    python splats.py SIMOD [SPLATS [SAMPLES]]

makes a scene of splats on a bumpy torus, has SIMOD sample and reconstruct it, with samples that are moved here, and
prints for each map how far centres, covariances, and colours in 100 directions are off; then draws a smaller scene
with a small rasteriser of its own (`reference/rasteriser.py`), and prints the PSNR against the analytic one.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import ply_files

sys.path.insert(0, str(Path(__file__).parent.parent / "reference"))
import rasteriser

RNG = np.random.default_rng(7)
DIRECTIONS = RNG.normal(size=(100, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def torus(count):
    """Points on a bumpy torus, and its normals there."""
    u, v = RNG.uniform(0, 2 * np.pi, (2, count))

    def at(u, v):
        radius = 0.35 + 0.02 * np.sin(7 * u) * np.cos(5 * v)
        ring = np.stack([np.cos(u), np.sin(u), 0 * u], 1)
        return ring + radius[:, None] * (ring * np.cos(v)[:, None] + np.array([0, 0, 1.0]) * np.sin(v)[:, None])

    h = 1e-5
    n = np.cross(at(u + h, v) - at(u - h, v), at(u, v + h) - at(u, v - h))
    return at(u, v), n / np.linalg.norm(n, axis=1)[:, None]


def scene(path, count, degree=3):
    """Writes splats that lie along the surface, flat and of all shapes."""
    p, n = torus(count)
    t = np.cross(n, RNG.normal(size=(count, 3)))
    t /= np.linalg.norm(t, axis=1)[:, None]
    frame = np.stack([t, np.cross(n, t), n], 2)
    # Not quite along the surface.
    frame = frame @ rotations(RNG.normal(size=(count, 3)) * 0.1)
    names = ["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{i}" for i in range(3)]
    rest = 3 * ((degree + 1) ** 2 - 1)
    names += [f"f_rest_{i}" for i in range(rest)] + ["opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    splats = np.zeros(count, [(name, "<f4") for name in names])
    put(splats, "xyz", p)
    spacing = np.sqrt(8 * np.pi**2 * 0.35 / count)
    size = spacing * np.exp(RNG.normal(size=(count, 3)) * 0.4) * [1, 1, 0.1]
    shuffle = RNG.permuted(np.tile(np.arange(3), (count, 1)), axis=1)
    rows = np.arange(count)[:, None]
    size, frame = size[rows, shuffle], np.take_along_axis(frame, shuffle[:, None, :], 2)
    frame[:, :, 2] *= np.sign(np.linalg.det(frame))[:, None]
    q = quaternions(frame) * RNG.choice([-1, 1], count)[:, None] * RNG.uniform(0.5, 2, count)[:, None]
    for i in range(3):
        splats[f"scale_{i}"] = np.log(size[:, i])
        splats[f"f_dc_{i}"] = np.sin(4 * p[:, i]) + 0.5
    for i in range(4):
        splats[f"rot_{i}"] = q[:, i]
    for i in range(rest):
        splats[f"f_rest_{i}"] = RNG.normal(size=count) * 0.15
    splats["opacity"] = RNG.normal(size=count) + 2
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {count}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    path.write_bytes(header.encode() + splats.tobytes())


def rotations(w):
    """Those of rotation vectors."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None] + 1e-300
    x, y, z = np.moveaxis(w, -1, 0)
    o = 0 * x
    k = np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1)) / angle
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def quaternions(m):
    """Those of rotations, real part first: by the eigenvector that K. Y. Bar-Itzhack (2000) gives."""
    k = np.zeros((len(m), 4, 4))
    for i, j in [(0, 1), (0, 2), (1, 2)]:
        k[:, i, j] = k[:, j, i] = m[:, i, j] + m[:, j, i]
    k[:, 0, 0] = m[:, 0, 0] - m[:, 1, 1] - m[:, 2, 2]
    k[:, 1, 1] = m[:, 1, 1] - m[:, 0, 0] - m[:, 2, 2]
    k[:, 2, 2] = m[:, 2, 2] - m[:, 0, 0] - m[:, 1, 1]
    k[:, 3, 3] = np.trace(m, axis1=1, axis2=2)
    for i, (a, b) in enumerate([(2, 1), (0, 2), (1, 0)]):
        k[:, 3, i] = k[:, i, 3] = m[:, a, b] - m[:, b, a]
    return np.roll(np.linalg.eigh(k)[1][:, :, 3], 1, axis=1)


def put(points, names, values):
    for i, name in enumerate(names):
        points[name] = values[:, i]


def columns(points, names):
    return np.stack([points[name].astype(float) for name in names], 1)


def covariances(points):
    q = columns(points, [f"rot_{i}" for i in range(4)])
    w, x, y, z = (q / np.linalg.norm(q, axis=1)[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    r = np.moveaxis(np.array(rows), 2, 0)
    half = r * np.exp(columns(points, [f"scale_{i}" for i in range(3)]))[:, None, :]
    return half @ half.transpose(0, 2, 1)


def harmonics(d):
    """The functions of bands 1 to 3, as the reference implementation of 3D Gaussian splatting has them."""
    x, y, z = np.moveaxis(d, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    c1 = 0.4886025119029199
    c2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396]
    c3 = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154]
    c3 += [-0.4570457994644658, 1.445305721320277, -0.5900435899266435]
    bands = [-c1 * y, c1 * z, -c1 * x]
    bands += [c2[0] * x * y, c2[1] * y * z, c2[2] * (2 * zz - xx - yy), c2[3] * x * z, c2[4] * (xx - yy)]
    bands += [c3[0] * y * (3 * xx - yy), c3[1] * x * y * z, c3[2] * y * (4 * zz - xx - yy)]
    bands += [c3[3] * z * (2 * zz - 3 * xx - 3 * yy), c3[4] * x * (4 * zz - xx - yy)]
    bands += [c3[5] * z * (xx - yy), c3[6] * x * (xx - 3 * yy)]
    return np.stack(bands, -1)


def colours(points, directions):
    """What depends on the direction, for each splat and channel; directions are the same for all, or of each."""
    y = harmonics(directions)
    count = sum(name.startswith("f_rest_") for name in points.dtype.names) // 3
    rest = columns(points, [f"f_rest_{i}" for i in range(3 * count)]).reshape(-1, 3, count)
    return np.einsum("sck,...dk->scd" if y.ndim == 2 else "sck,sdk->scd", rest, y[..., :count])


# Maps with their Jacobians.


def rigid(p):
    r = rotations(np.array([0.7, -1.1, 0.4]))
    return p @ r.T + [3.0, -1.0, 0.5], np.broadcast_to(r, (len(p), 3, 3))


def turned(p, angle, slope):
    """Rotation about z by an angle that depends on the point."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = p.T
    o, one = 0 * x, 1 + 0 * x
    image = np.stack([c * x - s * y, s * x + c * y, z], 1)
    jacobian = np.moveaxis(np.array([[c, -s, o], [s, c, o], [o, o, one]]), 2, 0)
    along = np.stack([-s * x - c * y, c * x - s * y, o], 1)
    return image, jacobian + along[:, :, None] * slope[:, None, :]


def twist(p, rate=0.8, start=0.0):
    slope = np.zeros_like(p)
    slope[:, 0] = rate
    # About x, by cyclic renaming.
    image, jacobian = turned(p[:, [1, 2, 0]], rate * (p[:, 0] - start), slope[:, [1, 2, 0]])
    return image[:, [2, 0, 1]], jacobian[:, [2, 0, 1]][:, :, [2, 0, 1]]


def untwist(p):
    return twist(p, -0.8)


def bend(p, rate=0.5):
    """The x axis becomes a circle about (0, 1 / rate, 0)."""
    x, y, z = p.T
    c, s, r = np.cos(rate * x), np.sin(rate * x), 1 / rate - y
    o = 0 * x
    image = np.stack([s * r, 1 / rate - c * r, z], 1)
    rows = [[rate * c * r, -s, o], [rate * s * r, c, o], [o, o, 1 + o]]
    return image, np.moveaxis(np.array(rows), 2, 0)


def bump(p):
    centre, width, way = np.array([1.0, 0.3, 0.3]), 0.5, np.array([0.1, 0.05, 0.2])
    d = p - centre
    g = np.exp(-(d**2).sum(1) / (2 * width**2))
    gradient = -d * (g / width**2)[:, None]
    return p + g[:, None] * way, np.eye(3) + way[:, None] * gradient[:, None, :]


MAPS = [rigid, twist, bend, bump]

# The same as steps of a session: what their range is in diagonals is filled in.
STEPS = {
    "twist": f'operation = "twist", angle = {np.degrees(3.2)}, axis = [1, 0, 0]',
    "bend": f'operation = "bend", angle = {np.degrees(2.0)}, axis = [1, 0, 0], direction = [0, 1, 0]',
}


def polar(j):
    u, _, v = np.linalg.svd(j)
    return u @ v


def analytic(points, map_):
    """The splats under the exact map: centres, covariances and what turns directions back."""
    p, j = map_(columns(points, "xyz"))
    return p, j @ covariances(points) @ j.transpose(0, 2, 1), polar(j)


def deform(simod, folder, map_, scene, out, *options):
    """Has SIMOD carry the scene over, by samples that are moved here."""
    data, start, samples = ply_files.read(folder / "s" / "samples.ply")
    put(samples, "xyz", map_(columns(samples, "xyz"))[0])
    ply_files.write(folder / "d.ply", data, start, samples)
    command = [simod, "reconstruct", folder / "s", "--deformed", folder / "d.ply", "-o", out, *options]
    run(command)
    return ply_files.vertices(out)


def run(command):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def run_session(simod, folder, name, scene, samples, diagonal, *options):
    """Has SIMOD do a session of one step."""
    step = f"{STEPS[name]}, center = [0, 0, 0], from = {-2 / diagonal}, to = {2 / diagonal}"
    session = f"""[model]\npath = "{scene.name}"\n[sampling]\nsamples = {samples}
[[step]]\ndeform = "warp"\nparams = {{ {step} }}\n"""
    (folder / "edit.toml").write_text(session)
    run([simod, "run", folder / "edit.toml", "-o", folder / "o.ply", *options])
    return ply_files.vertices(folder / "o.ply")


def size(sigma):
    return np.linalg.norm(sigma, axis=(1, 2))


def compare(name, rest, found, map_, diagonal):
    p, sigma, q = analytic(rest, map_)
    centres = np.linalg.norm(columns(found, "xyz") - p, axis=1) / diagonal
    off = size(covariances(found) - sigma) / size(sigma)
    # A part of the splats, as these are many numbers.
    some = slice(0, None, max(1, len(rest) // 20000))
    back = np.einsum("sji,dj->sdi", q[some], DIRECTIONS)
    expected = colours(rest[some], back)
    colour = np.abs(colours(found[some], DIRECTIONS) - expected).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))
    others = ["nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    kept = all((found[name] == rest[name]).all() for name in others)
    print(
        f"{name:17} centres {centres.max():.1e} rms {rms(centres):.1e} | covariance p99.9 {np.quantile(off, 0.999):.1e} "
        f"max {off.max():.1e} rms {rms(off):.1e} | colours p99.9 {np.quantile(colour, 0.999):.1e} max {colour.max():.1e} | "
        f"others kept {kept}",
        flush=True,
    )


def rms(x):
    return np.sqrt((x**2).mean())


def sample(simod, folder, scene, samples):
    command = [simod, "sample", scene, "-o", folder / "s", "--samples", samples]
    run(command)


def main():
    simod = sys.argv[1]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 1_000_000
    samples = int(sys.argv[3]) if len(sys.argv) > 3 else 200_000
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        scene(folder / "scene.ply", count)
        sample(simod, folder, folder / "scene.ply", samples)
        rest = ply_files.vertices(folder / "scene.ply")
        p = columns(rest, "xyz")
        diagonal = np.linalg.norm(p.max(0) - p.min(0))
        for map_ in MAPS:
            for method in ["blended-jets", "projected-barycentric"] if map_ in (rigid, twist) else ["blended-jets"]:
                name = map_.__name__ + (" pb" if method[0] == "p" else "")
                found = deform(simod, folder, map_, folder / "scene.ply", folder / "o.ply", "--method", method)
                compare(name, rest, found, map_, diagonal)
        # By plugins that know their map, so that the gradients at the samples are exact; and at every splat.
        for options in [], ["--exact"]:
            for map_ in (lambda p: twist(p, 0.8, -2.0)), bend:
                step = "bend" if map_ is bend else "twist"
                found = run_session(simod, folder, step, folder / "scene.ply", samples, diagonal, *options)
                compare(" ".join(["run", step, *options]), rest, found, map_, diagonal)
        # There and back: the deformed scene is sampled anew.
        deform(simod, folder, twist, folder / "scene.ply", folder / "o.ply")
        sample(simod, folder, folder / "o.ply", samples)
        found = deform(simod, folder, untwist, folder / "o.ply", folder / "back.ply")
        compare("round trip", rest, found, lambda p: (p, np.broadcast_to(np.eye(3), (len(p), 3, 3))), diagonal)

        scene(folder / "small.ply", 30_000)
        sample(simod, folder, folder / "small.ply", 10_000)
        rest = ply_files.vertices(folder / "small.ply")
        for map_ in MAPS:
            found = deform(simod, folder, map_, folder / "small.ply", folder / "o.ply")
            p, sigma, q = analytic(rest, map_)
            view = rasteriser.View(p)
            ahead = view.direction
            dc = columns(rest, [f"f_dc_{i}" for i in range(3)])
            opacity = 1 / (1 + np.exp(-columns(rest, ["opacity"])[:, 0]))

            def seen(points, d):
                return np.clip(0.5 + 0.28209479177387814 * dc + colours(points, d)[:, :, 0], 0, 1)

            expected = view.draw(p, sigma, seen(rest, (q.transpose(0, 2, 1) @ ahead)[:, None, :]), opacity)
            drawn = view.draw(columns(found, "xyz"), covariances(found), seen(found, ahead[None, :]), opacity)
            torn = view.draw(columns(found, "xyz"), covariances(rest), seen(rest, ahead[None, :]), opacity)
            psnr = [-10 * np.log10(((image - expected) ** 2).mean()) for image in (drawn, torn)]
            print(f"{map_.__name__:12} drawn: PSNR {psnr[0]:.1f} dB; with centres alone moved {psnr[1]:.1f} dB", flush=True)


if __name__ == "__main__":
    main()
