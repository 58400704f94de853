"""Samples as arrays, and the model written as they were deformed: the same as the command's."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import run

import simod

SESSION = """
[model]
path = "plane.ply"
[sampling]
samples = 4000
[[step]]
deform = "rbf"
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [-0.35, 0, 0], normal = [-1, 0, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ sphere = { center = [0.2, 0, 0.1], radius = 0.15 } }]
falloff = 0.1
move = { translate = [0.05, 0.2, 0.1], degrees = 20, axis = [0, 1, 0], pivot = [0.2, 0, 0.1] }
[[step]]
deform = "warp"
params = { operation = "twist", angle = 40, from = 0.2, to = 0.9 }
[[step.region]]
role = "mask"
shapes = [{ half-space = { point = [0, 0, 0], normal = [1, 0, 0] } }]
falloff = 0.2
[output]
path = "by-session.ply"
"""

REGIONS: list[dict[str, Any]] = [
    {"role": "fixed", "shapes": [{"half_space": {"point": [-0.35, 0, 0], "normal": [-1, 0, 0]}}]},
    {
        "role": "handle",
        "shapes": ({"sphere": {"center": np.array([0.2, 0, 0.1]), "radius": np.float64(0.15)}},),
        "falloff": 0.1,
        "move": {"translate": [0.05, 0.2, 0.1], "degrees": 20, "axis": [0, 1, 0], "pivot": [0.2, 0, 0.1]},
    },
]


def test_arrays(plane: Path) -> None:
    samples = simod.open(plane).sample(4000)
    count = len(samples)
    assert 3500 < count <= 4000
    for array in (samples.rest, samples.points, samples.normals):
        assert array.shape == (count, 3) and array.dtype == np.float64 and array.flags.c_contiguous
    assert np.array_equal(samples.rest, samples.points) and not samples.rest.flags.writeable
    assert np.allclose(np.linalg.norm(samples.normals, axis=1), 1, atol=1e-6)
    triangles = samples.triangles
    assert triangles.dtype == np.uint32 and triangles.shape[1] == 3 and triangles.max() < count
    assert samples.spacing.shape == (count,) and (samples.spacing > 0).all()
    low, high = samples.bounds
    assert (samples.rest >= low - 1e-9).all() and (samples.rest <= high + 1e-9).all()
    # The triangles cover the plane about once.
    a, b, c = (samples.rest[triangles[:, i]][:, [0, 2]] for i in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    assert area == pytest.approx(np.prod((high - low)[[0, 2]]), rel=0.1)


def test_normals_are_those_of_where_the_samples_are(plane: Path) -> None:
    samples = simod.open(plane).sample(2000)
    before = samples.normals
    samples.points[:] = samples.points[:, [1, 2, 0]]
    assert np.allclose(samples.normals, before[:, [1, 2, 0]], atol=1e-5)


def test_nothing_moved_is_the_same_file(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    samples = model.sample(2000)
    samples.points = samples.points + 0.0
    model.apply(samples, tmp_path / "same.ply")
    assert (tmp_path / "same.ply").read_bytes() == plane.read_bytes()


def test_a_translation_is_exact(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    samples = model.sample(2000)
    samples.points += [1.0, -2.0, 0.5]
    report = model.apply(samples, tmp_path / "moved.ply")
    before, after = (np.concatenate(list(simod.open(p).chunks())) for p in (plane, report.output))
    assert np.allclose(after, before + [1.0, -2.0, 0.5], atol=1e-6)
    assert report.folded_samples == 0 and report.samples == len(samples)
    assert report.expected_error is not None and report.expected_error.worst < 1e-5


def test_the_same_bytes_as_the_command(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    samples = model.sample(4000)
    run("sample", plane, "--samples", 4000, "-o", tmp_path / "p_s")
    samples.save(tmp_path / "own")
    own, theirs = ((tmp_path / f / "samples.ply").read_bytes() for f in ("own", "p_s"))
    assert own == theirs
    samples.points[:, 2] += 0.1 * np.sin(3 * samples.points[:, 0])
    samples.write(tmp_path / "deformed.ply")
    run("reconstruct", tmp_path / "p_s", "--deformed", tmp_path / "deformed.ply", "-o", tmp_path / "theirs.ply")
    model.apply(samples, tmp_path / "own.ply")
    assert (tmp_path / "own.ply").read_bytes() == (tmp_path / "theirs.ply").read_bytes()
    # And back from the file, in samples that were loaded.
    loaded = simod.load(tmp_path / "own")
    loaded.read(tmp_path / "deformed.ply")
    assert np.allclose(loaded.points, samples.points, atol=1e-6) and loaded.steps == ["deformed.ply"]
    model.apply(loaded, tmp_path / "loaded.ply")
    assert (tmp_path / "loaded.ply").read_bytes() == (tmp_path / "theirs.ply").read_bytes()


@pytest.mark.filterwarnings("ignore:rbf. the handles")
def test_plugins_give_the_same_bytes_as_a_session(plane: Path, tmp_path: Path) -> None:
    (tmp_path / "plane.ply").write_bytes(plane.read_bytes())
    (tmp_path / "edit.toml").write_text(SESSION)
    model = simod.open(tmp_path / "plane.ply")
    samples = model.sample(4000)
    samples.apply("rbf", regions=REGIONS)
    mask = {"role": "mask", "shapes": [{"half_space": {"point": [0, 0, 0], "normal": [1, 0, 0]}}], "falloff": 0.2}
    simod.plugins.warp(samples, operation="twist", angle=40, from_=0.2, params={"to": 0.9}, regions=iter([mask]))
    assert samples.steps == ["rbf", "warp"]
    model.apply(samples, tmp_path / "by-arrays.ply")
    session = simod.Session(tmp_path / "edit.toml")
    assert session.steps == ["rbf", "warp"] and session.model == tmp_path / "plane.ply"
    report = session.run(progress=lambda stage, fraction: None)
    assert report.output == tmp_path / "by-session.ply" and report.samples == len(samples)
    run("run", tmp_path / "edit.toml", "-o", tmp_path / "by-command.ply")
    by_command = (tmp_path / "by-command.ply").read_bytes()
    assert (tmp_path / "by-session.ply").read_bytes() == by_command
    assert (tmp_path / "by-arrays.ply").read_bytes() == by_command
    assert by_command != plane.read_bytes()


def test_regions_by_truth_values(plane: Path) -> None:
    samples = simod.open(plane).sample(3000)
    right, left = samples.points[:, 0] > 0.3, samples.points[:, 0] < -0.3
    samples.apply(
        "rbf",
        regions=[
            {"role": "handle", "where": right, "move": {"translate": [0, 0, 1]}},
            {"role": "fixed", "where": left},
        ],
    )
    moved = samples.points - samples.rest
    assert np.allclose(moved[right], [0, 0, 1], atol=2e-2) and np.allclose(moved[left], 0, atol=2e-2)
    between = moved[~right & ~left, 2]
    assert between.min() < 0.3 and between.max() > 0.7


def test_handles_by_id(plane: Path) -> None:
    samples = simod.open(plane).sample(2000)
    with pytest.raises(simod.Error, match="no handle `nowhere`") as unknown:
        samples.apply("lattice", handles={"nowhere": {"translate": [0, 0, 1]}})
    known = unknown.value.hint.removeprefix("there are ").split(", ")
    samples.apply("lattice", handles={known[0]: {"translate": [0, 0, 1]}})
    assert np.abs(samples.points - samples.rest).max() > 0.05


def test_undo_and_redo(plane: Path) -> None:
    samples = simod.open(plane).sample(2000)
    points = samples.points
    samples.apply("warp", operation="twist", angle=30)
    twisted = points.copy()
    assert samples.points is points and not np.array_equal(twisted, samples.rest)
    points[:, 2] += 1
    samples.apply("warp", operation="bend", angle=30)
    bent = points.copy()
    assert samples.undo() and np.array_equal(points, twisted + [0, 0, 1]) and samples.steps == ["warp"]
    assert samples.undo() and np.array_equal(points, samples.rest) and samples.steps == []
    assert not samples.undo()
    assert samples.redo() and samples.redo() and not samples.redo()
    assert np.array_equal(points, bent) and samples.points is points


def test_refine(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    samples = model.sample(1000)
    samples.apply("warp", operation="twist", angle=30)
    before, points = samples.points.copy(), samples.points
    rest = samples.rest
    samples.refine([{"sphere": {"center": before[500], "radius": 0.3}}], factor=8)
    count = len(samples)
    assert count > 1500 and samples.points.shape == samples.rest.shape == (count, 3)
    assert np.array_equal(samples.points[: len(before)], before) and np.array_equal(samples.rest[: len(before)], rest)
    model.apply(samples, tmp_path / "out.ply")
    assert samples.undo() and len(samples) == len(before) and np.array_equal(samples.points, points)
    samples.points[:, 1] += 0.2 * np.sin(60 * samples.points[:, 0])
    samples.refine(auto=True, samples=500)
    assert len(before) < len(samples) <= len(before) + 500
    with pytest.raises(simod.FormatError, match="no `shapes`|no shape"):
        samples.refine(factor=2)


def test_another_format(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    samples = model.sample(1000)
    samples.points *= 2
    with pytest.warns(simod.SimodWarning, match="what is lost"):
        model.apply(samples, tmp_path / "out.stl", lossy=True)
    assert simod.open(tmp_path / "out.stl").info.format.startswith("STL")


def test_measured(plane: Path, tmp_path: Path) -> None:
    (tmp_path / "plane.ply").write_bytes(plane.read_bytes())
    (tmp_path / "edit.toml").write_text(SESSION.split("[[step]]\ndeform = \"rbf\"")[0] + """
[[step]]
deform = "warp"
params = { operation = "twist", angle = 40 }
""")
    report = simod.Session(tmp_path / "edit.toml").run(tmp_path / "out.ply", measure=True, tolerance="0.01u")
    assert report.transfer_error is not None and report.transfer_error.vertices == report.vertices
    assert report.transfer_error.max * report.diagonal < 0.01
    assert report.certificate is not None and report.certificate.true_error is not None
    assert report.certificate.vertices.worst <= report.certificate.tolerance
    with pytest.raises(simod.ArgumentError, match="does not say where the result goes"):
        simod.Session(tmp_path / "edit.toml").run()


def test_compare(plane: Path, tmp_path: Path) -> None:
    @simod.deformer
    def lifted(points: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Half a unit up"""
        return points + [0, 0, 0.5]

    (tmp_path / "compare.toml").write_text(f"""
[model]
path = "{plane}"
[sampling]
samples = 2000
[[method]]
name = "by a function"
deform = "lifted"
[[method]]
name = "twisted"
deform = "warp"
params = {{ operation = "twist", angle = 10 }}
""")
    figures = simod.compare(tmp_path / "compare.toml", tmp_path / "page")
    assert [m["name"] for m in figures["methods"]] == ["by a function", "twisted"]
    assert all(m.get("error") is None for m in figures["methods"])
    assert (tmp_path / "page" / "index.html").stat().st_size > 1000
