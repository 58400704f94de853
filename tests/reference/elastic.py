"""Golden figures for the plugin `elastic`: bars that bend under their own weight, by finite elements.

Python 3.9 or newer:

    pip install numpy scipy               (made with numpy 2.4.6, scipy 1.17.1)
    python elastic.py                     writes elastic.json beside this file

The bar is 1 long (x) and 0.2 wide and high; the end at x = 0 is held, the weight draws along -z. Hexahedra of 27 nodes with
27 points of integration, 8 for what resists changes of volume (so that nothing locks), a neo-Hookean material with logarithms (J. Bonet, R. Wood, Nonlinear Continuum Mechanics for Finite
Element Analysis, 6.4.3), and Newton's method from the load at rest to the full one. Neither the elements nor the law of the
material are those of the plugin; for strains as small as here the laws are alike.

`moved` is how far points of the surface have moved, and `coarser` is by what part of the tip's way the figures differ from
those of a mesh of half as many elements each way.
"""

import itertools
from pathlib import Path

import goldens
import numpy as np
import scipy.sparse
import scipy.sparse.linalg

HERE = Path(__file__).parent
# Poisson's ratio, and the weight of a unit of volume over Young's modulus.
CASES = [(0.3, 0.004), (0.45, 0.004), (0.49, 0.002)]
POINTS = [[x, 0.0, z] for x in (0.25, 0.5, 0.75, 1.0) for z in (0.1, -0.1)]


def element(count):
    """Weights and slopes of the nodes at the points of integration, for nodes at -1, 0, 1 in the order of x, y, z."""
    at, weight = np.polynomial.legendre.leggauss(count)
    value = np.stack([at * (at - 1) / 2, 1 - at * at, at * (at + 1) / 2])
    slope = np.stack([at - 0.5, -2 * at, at + 0.5])
    nodes = list(itertools.product(range(3), repeat=3))
    points = list(itertools.product(range(count), repeat=3))
    n = np.array([[value[i, p] * value[j, q] * value[k, r] for i, j, k in nodes] for p, q, r in points])
    d = np.array(
        [
            [
                [
                    slope[i, p] * value[j, q] * value[k, r],
                    value[i, p] * slope[j, q] * value[k, r],
                    value[i, p] * value[j, q] * slope[k, r],
                ]
                for i, j, k in nodes
            ]
            for p, q, r in points
        ]
    )
    w = np.array([weight[p] * weight[q] * weight[r] for p, q, r in points])
    return n, d, w


def solve(parts, poisson, load):
    """Nodes at rest and moved, of a bar of so many elements along each axis; Young's modulus is 1."""
    counts = [2 * n + 1 for n in parts]
    size = np.array([1.0, 0.2, 0.2])
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1).reshape(-1, 3)
    rest = grid / (np.array(counts) - 1) * size - [0.0, 0.1, 0.1]
    number = lambda i, j, k: (i * counts[1] + j) * counts[2] + k
    elements = np.array(
        [
            [number(2 * a + i, 2 * b + j, 2 * c + k) for i, j, k in itertools.product(range(3), repeat=3)]
            for a, b, c in itertools.product(*[range(n) for n in parts])
        ]
    )
    mu, lame = 1 / (2 * (1 + poisson)), poisson / ((1 + poisson) * (1 - 2 * poisson))
    half = size / np.array(parts) / 2
    n, d, w = element(3)
    d, w = d / half, w * half.prod()
    _, few, few_w = element(2)
    few, few_w = few / half, few_w * half.prod()
    weights = np.zeros_like(rest)
    np.add.at(weights[:, 2], elements.ravel(), np.tile(-(w @ n), len(elements)))
    free = np.flatnonzero(np.repeat(rest[:, 0] > 0, 3))
    dofs = (3 * elements[:, :, None] + np.arange(3)).reshape(len(elements), -1)
    rows, columns = np.repeat(dofs, 81, axis=1).ravel(), np.tile(dofs, (1, 81)).ravel()
    identity = np.eye(3)
    x = rest.copy()
    for step in range(1, 5):
        for _ in range(30):
            inner = np.zeros_like(rest)
            blocks = 0.0
            # dP = mu dF + (mu - lame log J) F^-T dF^T F^-T + lame (F^-T : dF) F^-T
            for shear, bulk, d_p, w_p in [(mu, 0.0, d, w), (0.0, lame, few, few_w)]:
                f = np.einsum("eai,paj->epij", x[elements], d_p)
                inverse = np.linalg.inv(f)
                log = np.log(np.linalg.det(f))
                stress = shear * f + (bulk * log - shear)[..., None, None] * inverse.swapaxes(-1, -2)
                np.add.at(inner, elements, np.einsum("epij,paj,p->eai", stress, d_p, w_p))
                tangent = shear * np.einsum("ik,jl->ijkl", identity, identity) + np.einsum(
                    "ep,epjk,epli->epijkl", shear - bulk * log, inverse, inverse
                )
                tangent = tangent + bulk * np.einsum("epji,eplk->epijkl", inverse, inverse)
                blocks = blocks + np.einsum("paj,epijkl,pbl,p->eaibk", d_p, tangent, d_p, w_p, optimize=True)
            lacking = (load * step / 4 * weights - inner).reshape(-1)
            stiff = scipy.sparse.csr_matrix((blocks.ravel(), (rows, columns)), shape=(x.size, x.size))
            by = np.zeros(x.size)
            by[free] = scipy.sparse.linalg.spsolve(stiff[free][:, free].tocsc(), lacking[free])
            x += by.reshape(-1, 3)
            if np.abs(by).max() < 1e-10:
                break
        else:
            raise RuntimeError("no rest")
    return rest, x


def moved(parts, poisson, load):
    rest, x = solve(parts, poisson, load)
    index = [np.abs(rest - p).sum(axis=1).argmin() for p in POINTS]
    assert np.allclose(rest[index], POINTS)
    return (x - rest)[index]


def main():
    cases = []
    for poisson, load in CASES:
        coarse, fine = moved((8, 2, 2), poisson, load), moved((16, 4, 4), poisson, load)
        off = np.abs(fine - coarse).max() / np.linalg.norm(fine[-1])
        print(poisson, load, fine[-1], off)
        cases.append({"poisson": poisson, "load": load, "coarser": round(off, 6), "moved": fine.round(7).tolist()})
    goldens.write(HERE / "elastic.json", {"points": POINTS, "cases": cases})


if __name__ == "__main__":
    main()
