"""Objects of trimesh, Open3D, PyVista and laspy: their arrays are sampled, and what became of them goes back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import run
from numpy.typing import NDArray

import simod

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""A quarter of a turn about z."""


@pytest.fixture(scope="session")
def amphora(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A jar of 40 000 vertices with faces, normals and colours."""
    path = tmp_path_factory.mktemp("models") / "amphora.ply"
    run("generate", "--vertices", 40_000, "-o", path)
    return path


def twist(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turned about y by a quarter of a turn in all."""
    x, y, z = points.T
    angle = np.pi / 2 * y / 2
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x + s * z, y, c * z - s * x], axis=1)


def is_near(found: Any, expected: NDArray[np.float64], worst: float) -> bool:
    """Whether places differ by at most a part of the diagonal."""
    apart = np.linalg.norm(np.asarray(found, np.float64) - expected, axis=1).max()
    return bool(apart <= worst * np.linalg.norm(np.ptp(expected, axis=0)))


def test_trimesh(amphora: Path) -> None:
    trimesh = pytest.importorskip("trimesh", exc_type=ImportError)
    mesh = trimesh.load(amphora, process=False)
    rest = np.array(mesh.vertices)
    samples = simod.sample(mesh.vertices, mesh.vertex_normals, triangles=mesh.faces, samples=4000)
    assert len(samples.triangles) > len(samples)
    samples.points = twist(samples.points)
    mesh.vertices, normals = samples.transfer(mesh.vertices, mesh.vertex_normals)
    assert normals is not None and is_near(mesh.vertices, twist(rest), 2e-4)
    # Its normals, found anew from the faces, are those that were turned.
    assert np.median(np.einsum("ij,ij->i", mesh.vertex_normals, normals)) > 0.99


def test_open3d(amphora: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    cloud = open3d.io.read_point_cloud(str(amphora))
    rest, normals = np.array(cloud.points), np.array(cloud.normals)
    samples = simod.sample(cloud.points, cloud.normals, samples=4000)
    samples.points = samples.points @ TURN.T
    moved, turned = samples.transfer(cloud.points, cloud.normals)
    cloud.points, cloud.normals = map(open3d.utility.Vector3dVector, (moved, turned))
    assert is_near(cloud.points, rest @ TURN.T, 1e-6)
    assert np.allclose(np.asarray(cloud.normals), normals @ TURN.T, atol=1e-3)
    assert cloud.has_colors()


def test_pyvista(amphora: Path) -> None:
    pyvista = pytest.importorskip("pyvista", exc_type=ImportError)
    mesh = pyvista.read(amphora)
    rest = np.array(mesh.points, np.float64)
    samples = simod.sample(mesh.points, triangles=mesh.regular_faces, samples=4000)
    samples.points = twist(samples.points)
    mesh.points = samples.transfer(mesh.points)[0]
    assert is_near(mesh.points, twist(rest), 2e-4) and mesh.n_cells > 40_000


def test_laspy(amphora: Path, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy", exc_type=ImportError)
    run("convert", amphora, tmp_path / "a.laz", "--lossy", "--step", 0.0001)
    scan = laspy.read(tmp_path / "a.laz")
    rest = np.array(scan.xyz)
    samples = simod.sample(scan.xyz, samples=4000)
    samples.points += [0, 0, 0.25]
    scan.xyz = samples.transfer(scan.xyz)[0]
    scan.write(tmp_path / "up.laz")
    again = simod.open(tmp_path / "up.laz")
    moved = np.concatenate(list(again.chunks()))
    assert np.abs(moved - rest - [0, 0, 0.25]).max() < 0.000051
