"""Arrays in memory: sampled, deformed, and carried over."""

import numpy as np
import pytest
from numpy.typing import NDArray

import simod


def sphere(count: int) -> NDArray[np.float64]:
    """Points spread over the unit sphere."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def test_points_alone() -> None:
    points = sphere(50_000) * 10 + [1e6, 0, 0]
    samples = simod.sample(points, samples=2000)
    assert 1500 < len(samples) <= 2000 and samples.triangles.shape == (0, 3) and samples.colors is None
    assert np.abs(np.linalg.norm(samples.points - [1e6, 0, 0], axis=1) - 10).max() < 0.05
    inward = -np.sign(np.einsum("ij,ij->i", samples.normals, samples.points - [1e6, 0, 0]))
    assert abs(inward.sum()) == len(samples)
    moved, normals = samples.transfer(points)
    assert np.array_equal(moved, points) and normals is None
    samples.points += [0, 0, 5]
    moved, _ = samples.transfer(points)
    assert np.allclose(moved, points + [0, 0, 5], atol=1e-5)


def test_points_with_normals_turn() -> None:
    points = sphere(40_000)
    samples = simod.sample(points, points.astype(np.float32), samples=3000)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    samples.points[:] = samples.points @ turn.T
    points[3] = np.nan
    moved, normals = samples.transfer(points, np.nan_to_num(points), progress=lambda stage, fraction: None)
    assert normals is not None and np.isnan(moved[3]).all()
    there = np.isfinite(points[:, 0])
    assert np.allclose(moved[there], points[there] @ turn.T, atol=1e-5)
    assert np.allclose(normals[there], points[there] @ turn.T, atol=1e-3)


def test_bad_arrays() -> None:
    points = sphere(1000)
    with pytest.raises(simod.ArgumentError, match=r"points: an array of shape \(1000, 2\)"):
        simod.sample(points[:, :2])
    with pytest.raises(simod.ArgumentError, match=r"normals: an array of shape \(999, 3\)"):
        simod.sample(points, points[1:])
    with pytest.raises(TypeError, match="triangles: an array of float64"):
        simod.sample(points, triangles=points)
    with pytest.raises(simod.ArgumentError, match="not from 0 to 999"):
        simod.sample(points, triangles=[[0, 1, 1000]])
    with pytest.raises(simod.DegenerateError, match="no vertices"):
        simod.sample(np.zeros((0, 3)))
    with pytest.raises(simod.DegenerateError):
        simod.sample(np.full((10, 3), np.nan))
    samples = simod.sample(points, samples=100)
    with pytest.raises(simod.ArgumentError, match="no model that a folder"):
        samples.save("folder")
    with pytest.raises(simod.ArgumentError, match="cannot be refined"):
        samples.refine(auto=True)
    assert len(simod.sample(points[:1])) == 1
