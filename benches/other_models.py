"""Models on which no weight of the expected error was chosen, about 300 000 vertices each, with faces and without
normals: torus.ply, rings.ply, cone.ply and prism.ply in the folder at hand.

    python benches/other_models.py
"""

import numpy as np


def write(path, points, triangles):
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    with open(path, "wb") as file:
        file.write(head.encode() + points.astype("<f4").tobytes() + faces.tobytes())


def grid(rows, columns, closed_rows=True, closed_columns=True):
    """The triangles of a grid of points, whose ends meet where it is closed."""
    i = np.arange(rows if closed_rows else rows - 1)[:, None]
    j = np.arange(columns if closed_columns else columns - 1)[None]
    after_i, after_j = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = (u * columns + v for u, v in ((i, j), (after_i, j), (after_i, after_j), (i, after_j)))
    return np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def torus(rows, columns, large, small):
    u, v = np.meshgrid(
        2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    across = large + small * np.cos(v)
    points = np.stack([across * np.cos(u), across * np.sin(u), small * np.sin(v)], -1)
    return points.reshape(-1, 3), grid(rows, columns)


def cone(rows, columns):
    u, h = np.meshgrid(2 * np.pi * np.arange(rows) / rows, np.linspace(0.0005, 1, columns), indexing="ij")
    points = np.stack([0.5 * h * np.cos(u), 2 * (1 - h), 0.5 * h * np.sin(u)], -1)
    return points.reshape(-1, 3), grid(rows, columns, True, False)


def prism():
    """Sides and ends, which share no vertices."""
    corners = 0.4 * np.exp(1j * np.pi / 3 * np.arange(7))
    parts = []
    for first, last in zip(corners[:-1], corners[1:]):
        s, z = np.meshgrid(np.linspace(0, 1, 130), np.linspace(0, 2, 330), indexing="ij")
        at = first + (last - first) * s
        parts.append(np.stack([at.real, at.imag, z], -1))
    for end in (0.0, 2.0):
        for first, last in zip(corners[:-1], corners[1:]):
            s, r = np.meshgrid(np.linspace(0, 1, 70), np.linspace(0.001, 1, 70), indexing="ij")
            at = (first + (last - first) * s) * r
            parts.append(np.stack([at.real, at.imag, np.full_like(s, end)], -1))
    starts = np.cumsum([0] + [part[..., 0].size for part in parts])
    triangles = [grid(*part.shape[:2], False, False) + start for part, start in zip(parts, starts)]
    return np.concatenate([part.reshape(-1, 3) for part in parts]), np.concatenate(triangles)


if __name__ == "__main__":
    write("torus.ply", *torus(800, 375, 1.0, 0.4))
    points, triangles = torus(700, 210, 1.0, 0.15)
    other = points[:, [0, 2, 1]] + [1, 0, 0]
    both = np.concatenate([triangles, triangles[:, [0, 2, 1]] + len(points)])
    write("rings.ply", np.concatenate([points, other]), both)
    write("cone.ply", *cone(500, 600))
    write("prism.ply", *prism())
