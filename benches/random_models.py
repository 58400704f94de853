"""Random models, about 300 000 vertices each: NUMBER.ply in the folder at hand for each number given. The
number is the seed; the kind of surface follows from it (blob, superquadric, box with fillets, swept tube,
wavy sheet, lathed body), and so do its normals, its noise and how it lies.

    python benches/random_models.py 0 1 2
"""

import sys

import numpy as np

SIDE = 224
KINDS = 6


def cube_sphere():
    """Directions on the six faces of a cube, and triangles; where faces meet, places have the same bits."""
    a = np.tan(np.linspace(-np.pi / 4, np.pi / 4, SIDE))
    u, v = np.round(np.meshgrid(a, a, indexing="ij"), 9)
    one = np.ones_like(u)
    faces = [(one, u, v), (-one, v, u), (v, one, u), (u, -one, v), (u, v, one), (v, u, -one)]
    points = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in faces])
    points, place = np.unique(points, axis=0, return_inverse=True)
    triangles = np.concatenate([grid(SIDE, SIDE, False, False) + k * SIDE * SIDE for k in range(6)])
    return points / np.linalg.norm(points, axis=1)[:, None], place.ravel()[triangles]


def grid(rows, columns, closed_rows, closed_columns):
    """The triangles of a grid of points, whose ends meet where it is closed."""
    i = np.arange(rows if closed_rows else rows - 1)[:, None]
    j = np.arange(columns if closed_columns else columns - 1)[None]
    after_i, after_j = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = (u * columns + v for u, v in ((i, j), (after_i, j), (after_i, after_j), (i, after_j)))
    return np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def waves(random, points, count, least, most):
    """A sum of plane waves, of amplitudes that fall with their frequencies; at most about 1."""
    sum_ = 0
    for _ in range(count):
        wave = random.normal(size=points.shape[1])
        frequency = random.uniform(least, most)
        phase = points @ (frequency * wave / np.linalg.norm(wave)) + random.uniform(0, 2 * np.pi)
        sum_ = sum_ + np.sin(phase) * least / frequency / count**0.5
    return sum_


def blob(random):
    d, triangles = cube_sphere()
    height = random.uniform(0.15, 0.35)
    return d * np.exp(height * waves(random, d, 8, 2, random.uniform(3, 9)))[:, None], triangles


def superquadric(random):
    d, triangles = cube_sphere()
    sizes, power = random.uniform(0.4, 1, 3), random.uniform(2.5, 6)
    return d / (np.abs(d / sizes) ** power).sum(1)[:, None] ** (1 / power), triangles


def box(random):
    d, triangles = cube_sphere()
    radius, sizes = random.uniform(0.05, 0.4), random.uniform(0.5, 1, 3)
    on_cube = d / np.abs(d).max(1)[:, None]
    core = np.clip(on_cube, radius - 1, 1 - radius)
    out = on_cube - core
    return (core + radius * out / np.linalg.norm(out, axis=1)[:, None]) * sizes, triangles


def tube(random):
    rows, columns = 1500, 200
    s = 2 * np.pi * np.arange(rows) / rows
    curve, slope = 0, 0
    for k, size in ((1, 1), (2, 0.45), (3, 0.2)):
        a, b = size * random.normal(size=(2, 3)) / 1.2
        curve = curve + np.cos(k * s)[:, None] * a + np.sin(k * s)[:, None] * b
        slope = slope + k * (np.cos(k * s)[:, None] * b - np.sin(k * s)[:, None] * a)
    tangent = slope / np.linalg.norm(slope, axis=1)[:, None]
    # The rotation-minimizing frame, and what it lacks to close.
    frame = [np.cross(tangent[0], np.roll(tangent[0], 1))]
    for t in tangent[1:]:
        frame.append(frame[-1] - t * (t @ frame[-1]))
        frame[-1] /= np.linalg.norm(frame[-1])
    e = np.array(frame) / np.linalg.norm(frame[0])
    e /= np.linalg.norm(e, axis=1)[:, None]
    f = np.cross(tangent, e)
    gap = np.arctan2(e[-1] @ f[0], e[-1] @ e[0])
    v = 2 * np.pi * np.arange(columns)[None] / columns - gap * (s / (2 * np.pi))[:, None]
    radius = 0.12 * (1 + 0.3 * np.sin(random.integers(1, 6) * s + 1))[:, None]
    across = (radius * np.cos(v))[..., None] * e[:, None] + (radius * np.sin(v))[..., None] * f[:, None]
    points = curve[:, None] + across
    return points.reshape(-1, 3), grid(rows, columns, True, True)


def sheet(random):
    rows, columns = 600, 500
    width = random.uniform(0.4, 1) * np.linspace(-1, 1, columns)
    x, z = np.meshgrid(np.linspace(-1, 1, rows), width, indexing="ij")
    places = np.stack([x, z], -1).reshape(-1, 2)
    y = random.uniform(0.02, 0.15) * waves(random, places, 6, 3, random.uniform(4, 15))
    points = np.stack([places[:, 0], y, places[:, 1]], -1)
    turn = random.uniform(0.01, 3)  # how far the sheet is rolled
    angle, radius = points[:, 0] * turn, 1 / turn - points[:, 1]
    rolled = np.stack([radius * np.sin(angle), 1 / turn - radius * np.cos(angle), points[:, 2]], -1)
    return rolled, grid(rows, columns, False, False)


def lathed(random):
    rows, corners = 500, random.integers(4, 9)
    radius, height = random.uniform(0.2, 0.8, corners), np.sort(random.uniform(-1, 1, corners))
    lengths = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    at = np.linspace(0, lengths[-1], 600)
    r, h = np.interp(at, lengths, radius), np.interp(at, lengths, height)
    if random.random() < 0.5:  # without creases
        kernel = np.hanning(81) / np.hanning(81).sum()
        r, h = (np.convolve(np.pad(x, 40, "edge"), kernel, "valid") for x in (r, h))
    u = 2 * np.pi * np.arange(rows)[:, None] / rows
    points = np.stack([r * np.cos(u), h + 0 * u, r * np.sin(u)], -1)
    return points.reshape(-1, 3), grid(rows, 600, True, False)


def normals_of(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    at = [triangles[:, k] for k in range(3)]
    sum_ = np.stack([sum(np.bincount(k, normal[:, i], len(points)) for k in at) for i in range(3)], -1)
    return sum_ / np.maximum(np.linalg.norm(sum_, axis=1), 1e-30)[:, None]


def model(seed):
    random = np.random.default_rng(seed)
    kind = (blob, superquadric, box, tube, sheet, lathed)[seed % KINDS]
    points, triangles = kind(random)
    normals = normals_of(points, triangles)
    if random.random() < 0.4:  # rough
        size = np.linalg.norm(np.ptp(points, axis=0)) * 10 ** random.uniform(-4.5, -3)
        points = points + normals * (size * random.normal(size=len(points)))[:, None]
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    with_normals = random.random() < 0.5
    return points @ turn.T, triangles, normals @ turn.T if with_normals else None


def write(path, points, triangles, normals):
    values = points if normals is None else np.concatenate([points, normals], 1)
    names = ("x", "y", "z", "nx", "ny", "nz")[: values.shape[1]]
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        + "".join(f"property float {name}\n" for name in names)
        + f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    with open(path, "wb") as file:
        file.write(head.encode() + values.astype("<f4").tobytes() + faces.tobytes())


if __name__ == "__main__":
    for seed in sys.argv[1:]:
        write(f"{seed}.ply", *model(int(seed)))
