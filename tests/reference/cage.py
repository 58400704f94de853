"""Mean value coordinates for the tests of plugins/cage: writes cage.obj and cage.csv beside itself.

By VTK's implementation of Ju, Schaefer and Warren 2005, held against the integral that defines them, which
is taken by quadrature over the cage's triangles. (libigl's `mvc` is of polygons in the plane.)

    pip install numpy vtk
    python cage.py
"""

from pathlib import Path

import numpy as np
import vtk

FOLDER = Path(__file__).parent


def cage():
    """A closed surface with dents: an octahedron, each of its edges in three, pushed in and out."""
    n = 3
    keys, triangles = {}, []

    def vertex(x, y, z):
        return keys.setdefault((x, y, z), len(keys))

    for sx in (1, -1):
        for sy in (1, -1):
            for sz in (1, -1):
                def corner(i, j):
                    return vertex(sx * i, sy * j, sz * (n - i - j))

                for i in range(n):
                    for j in range(n - i):
                        some = [(corner(i, j), corner(i + 1, j), corner(i, j + 1))]
                        if i + j < n - 1:
                            some.append((corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)))
                        flip = sx * sy * sz < 0
                        triangles += [t[::-1] if flip else t for t in some]
    grid = np.array(list(keys), float)
    direction = grid / np.linalg.norm(grid, axis=1, keepdims=True)
    radius = 1 + 0.35 * np.sin(2.5 * direction[:, 0] + 4 * direction[:, 1] - 3 * direction[:, 2])
    return np.round(direction * radius[:, None], 3), np.array(triangles)


def points():
    """Inside and outside."""
    k = np.arange(60)
    directions = np.stack([np.sin(1.3 * k), np.cos(2.1 * k + 0.4), np.sin(3.7 * k - 1)], axis=1)
    return np.round(directions * (0.2 + k / 60)[:, None], 3)


def by_vtk(vertices, triangles, x):
    data, corners, weights = vtk.vtkPoints(), vtk.vtkIdList(), [0.0] * len(vertices)
    data.SetDataTypeToDouble()
    for p in vertices:
        data.InsertNextPoint(p)
    for v in triangles.ravel():
        corners.InsertNextId(int(v))
    vtk.vtkMeanValueCoordinatesInterpolator.ComputeInterpolationWeights(x, data, corners, weights)
    return np.array(weights)


def by_quadrature(vertices, triangles, x, n=200):
    """The integral of each vertex' hat function over the sphere about x; and how near x is."""
    i, j = [a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij")]
    up, down = i + j < n, i + j < n - 1
    # The middles of the parts of a triangle.
    a, b = (np.concatenate([k[up] + 1 / 3, k[down] + 2 / 3]) / n for k in (i, j))
    bary = np.stack([a, b, 1 - a - b])
    weights, nearest = np.zeros(len(vertices)), np.inf
    for t in triangles:
        a, b, c = vertices[t]
        y = bary.T @ vertices[t] - x
        area = np.cross(b - a, c - a) / 2 / bary.shape[1]
        square = (y * y).sum(axis=1)
        nearest = min(nearest, square.min() ** 0.5)
        weights[t] += bary @ ((y @ area) / square**2)
    return weights / weights.sum(), nearest


def main():
    vertices, triangles = cage()
    lines = ["# by cage.py"]
    lines += ["v " + " ".join(f"{c:g}" for c in p) for p in vertices]
    lines += ["f " + " ".join(str(v + 1) for v in t) for t in triangles]
    (FOLDER / "cage.obj").write_text("\n".join(lines) + "\n")

    rows, worst = ["# by cage.py: a point, and its coordinates as to the vertices of cage.obj"], 0
    for x in points():
        weights = by_vtk(vertices, triangles, x)
        assert abs(weights @ vertices - x).max() < 1e-9
        integral, distance = by_quadrature(vertices, triangles, x)
        if distance > 0.1:
            worst = max(worst, abs(weights - integral).max())
        rows.append(",".join(f"{c:.12g}" for c in [*x, *weights]))
    print(f"{len(rows) - 1} points; the quadrature differs by {worst:.1e} at most")
    assert worst < 1e-3
    (FOLDER / "cage.csv").write_text("\n".join(rows) + "\n")


main()
