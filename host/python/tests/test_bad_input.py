"""Arrays and files that are not what they should be: an exception that says so, and nothing left behind."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import run

import simod


@pytest.fixture
def samples(plane: Path) -> simod.Samples:
    return simod.open(plane).sample(1000)


def test_arrays_of_wrong_shape(samples: simod.Samples) -> None:
    count = len(samples)
    for shape in [(count - 1, 3), (count, 2), (3, count), (3 * count,), ()]:
        with pytest.raises(simod.ArgumentError, match=rf"not \({count}, 3\)"):
            samples.points = np.zeros(shape)
    assert np.array_equal(samples.points, samples.rest)


def test_arrays_of_wrong_numbers(samples: simod.Samples) -> None:
    for dtype in ["c16", "O", "?", "U8", "datetime64[s]"]:
        with pytest.raises(TypeError, match="not of real numbers"):
            samples.points = np.zeros((len(samples), 3), dtype=dtype)


def test_arrays_of_other_layouts(samples: simod.Samples) -> None:
    wanted = samples.rest + [1, 2, 3]
    big_endian = wanted.astype(">f8")
    strided = np.zeros((2 * len(samples), 4))[::2, :3]
    strided[:] = wanted
    for array in (np.asfortranarray(wanted), big_endian, strided, wanted[::-1][::-1], wanted.tolist()):
        samples.points = samples.rest
        samples.points = array
        assert np.array_equal(samples.points, wanted)
    samples.points = wanted.astype(np.float32)
    assert np.allclose(samples.points, wanted, atol=1e-6)
    samples.points = np.round(wanted).astype(np.int32)
    assert samples.points.dtype == np.float64


def test_numbers_that_are_not_finite(samples: simod.Samples, plane: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    for bad, message in [(np.nan, "not finite"), (np.inf, "not finite"), (1e300, "too far|not finite")]:
        samples.points[:] = samples.rest
        samples.points[17, 1] = bad
        with pytest.raises(simod.DegenerateError, match=message):
            simod.open(plane).apply(samples, out)
        with pytest.raises(simod.DegenerateError, match=message):
            samples.apply("warp", angle=10)
    assert list(tmp_path.iterdir()) == []


def test_an_array_that_was_reshaped(samples: simod.Samples, plane: Path, tmp_path: Path) -> None:
    with pytest.warns(DeprecationWarning) if np.lib.NumpyVersion(np.__version__) >= "2.5.0" else _nothing():
        samples.points.shape = (3, len(samples))
    with pytest.raises(ValueError, match="not of shape"):
        simod.open(plane).apply(samples, tmp_path / "out.ply")


def test_rest_is_read_only(samples: simod.Samples) -> None:
    with pytest.raises(ValueError, match="read-only"):
        samples.rest[0] = 0
    with pytest.raises(AttributeError):
        samples.rest = samples.points  # type: ignore[misc]


def test_masks_of_wrong_shape(samples: simod.Samples) -> None:
    for mask in (np.ones(3, dtype=bool), np.ones(len(samples)), np.zeros(len(samples), dtype=bool)):
        with pytest.raises(simod.ArgumentError):
            samples.apply("rbf", regions=[{"role": "fixed", "where": mask}])


def test_sampling_that_makes_no_sense(plane: Path) -> None:
    model = simod.open(plane)
    for wrong in [{"samples": 0}, {"samples": -5}, {"error": 0.0}, {"error": float("nan")}, {"grid": 0}]:
        with pytest.raises(simod.ArgumentError):
            model.sample(**wrong)  # type: ignore[arg-type]
    with pytest.raises(simod.ArgumentError, match="keep one|both"):
        model.sample(10, error=1e-3)
    with pytest.raises(simod.ArgumentError, match="`by` cannot be \"size\""):
        model.sample(by="size")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="neither True nor a function"):
        model.sample(progress=3)  # type: ignore[arg-type]


def test_a_model_that_changed_since_it_was_sampled(plane: Path, tmp_path: Path) -> None:
    path, out = tmp_path / "model.ply", tmp_path / "out.ply"
    path.write_bytes(plane.read_bytes())
    model = simod.open(path)
    samples = model.sample(1000)
    samples.points *= 2
    changed = bytearray(plane.read_bytes())
    changed[5000] ^= 1
    path.write_bytes(changed)
    with pytest.raises(simod.MismatchError, match="changed since it was sampled") as mismatch:
        model.apply(samples, out)
    assert "--" not in mismatch.value.hint
    path.write_bytes(changed[:-100])
    with pytest.raises(simod.Error):
        model.apply(samples, out)
    path.unlink()
    with pytest.raises(simod.FileError, match="is gone since it was opened"):
        model.apply(samples, out)
    path.with_name("elsewhere.ply").write_bytes(plane.read_bytes())
    simod.open(path.with_name("elsewhere.ply")).apply(samples, out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["elsewhere.ply", "out.ply"]


def test_another_model_than_was_sampled(samples: simod.Samples, bar: Path, tmp_path: Path) -> None:
    with pytest.raises(simod.MismatchError):
        simod.open(bar).apply(samples, tmp_path / "out.ply")


def test_what_must_not_be_written_over(samples: simod.Samples, plane: Path, tmp_path: Path) -> None:
    before = plane.read_bytes()
    with pytest.raises(simod.ArgumentError, match="would be overwritten"):
        simod.open(plane).apply(samples, plane)
    assert plane.read_bytes() == before
    letter = tmp_path / "letter.ply"
    letter.write_text("Dear reader, this is no model")
    with pytest.raises(simod.ArgumentError, match="is no model"):
        simod.open(plane).apply(samples, letter)
    assert "overwrite=True" in str(_error(lambda: simod.open(plane).apply(samples, letter)))
    simod.open(plane).apply(samples, letter, overwrite=True)
    with pytest.raises(simod.FileError):
        simod.open(plane).apply(samples, tmp_path / "no" / "folder.ply")
    with pytest.raises(simod.ArgumentError, match="cannot be \"turn\""):
        simod.open(plane).apply(samples, tmp_path / "x.ply", normals="turn")  # type: ignore[arg-type]


def test_sessions_with_mistakes(tmp_path: Path) -> None:
    path = tmp_path / "edit.toml"
    path.write_text("[[step]]\ndeform = 3\n")
    with pytest.raises(simod.FormatError, match="edit.toml, line 2"):
        simod.Session(path)
    path.write_text('[model]\npath = "missing.ply"\n[output]\npath = "out.ply"\n')
    with pytest.raises(simod.FileError, match="is gone"):
        simod.Session(path).run()


def test_a_folder_that_is_no_sampled_model(tmp_path: Path) -> None:
    with pytest.raises(simod.ArgumentError, match="no sampled model"):
        simod.load(tmp_path)
    assert "sample" in run("--help")


def _error(call: Callable[[], object]) -> simod.Error:
    try:
        call()
    except simod.Error as e:
        return e
    raise AssertionError("nothing was raised")


class _nothing:
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...
