"""Models: what they are, and their vertices chunk by chunk."""

from pathlib import Path

import numpy as np
import pytest
from conftest import run

import simod


def vertices(path: Path) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.concatenate(list(simod.open(path).chunks()))


def test_info(plane: Path) -> None:
    model = simod.open(plane)
    info = model.info
    assert len(model) == info.vertices and abs(len(model) - 60_000) < 2000
    assert info.format.startswith("PLY") and info.has_normals and info.faces > info.vertices
    assert info.bytes == plane.stat().st_size and model.path == plane
    assert info.scale is None and info.crs is None and model.unit is None
    assert "plane.ply" in repr(model)


def test_paths_are_texts_or_paths(plane: Path) -> None:
    assert len(simod.open(str(plane))) == len(simod.open(plane))


def test_chunks_are_all_vertices_in_order(plane: Path, bar: Path) -> None:
    model = simod.open(bar)
    chunks = list(model.chunks())
    assert len(chunks) > 10
    for chunk in chunks:
        assert chunk.dtype == np.float64 and chunk.ndim == 2 and chunk.shape[1] == 3 and len(chunk) <= 65_536
    whole = np.concatenate(chunks)
    assert whole.shape == (len(model), 3)
    # As the header says where they are.
    header = bar.read_bytes()[:4096].split(b"end_header\n")[0].decode()
    properties = [line.split()[1:] for line in header.split("element face")[0].splitlines() if "property" in line]
    kinds = {"float": "<f4", "uchar": "u1"}
    record = np.dtype([(name, kinds[kind]) for kind, name in properties])
    raw = np.fromfile(bar, record, count=len(model), offset=len(header) + len("end_header\n"))
    assert np.array_equal(whole, np.stack([raw[axis] for axis in "xyz"], axis=1).astype(np.float64))
    some = np.concatenate(list(model.chunks(70_000, 140_000)))
    assert np.array_equal(some, whole[70_000:140_000])
    assert np.array_equal(np.concatenate(list(model.chunks(-5))), whole[-5:])
    assert list(model.chunks(10, 10)) == []


def test_chunks_that_nobody_reads_on_are_no_harm(bar: Path) -> None:
    for _ in range(20):
        next(simod.open(bar).chunks())


def test_what_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(simod.FileError, match="no such file") as missing:
        simod.open(tmp_path / "missing.ply")
    assert missing.value.hint == "check the path; it is relative to the current folder"
    assert "hint: check the path" in str(missing.value) and isinstance(missing.value, OSError)
    letter = tmp_path / "letter.doc"
    letter.write_bytes(b"Dear reader,")
    with pytest.raises(simod.FormatError, match="no model of a known format"):
        simod.open(letter)
    with pytest.raises(TypeError):
        simod.open(3)  # type: ignore[arg-type]


def test_a_file_that_is_cut_off_is_told_while_it_is_read(plane: Path, tmp_path: Path) -> None:
    run("convert", plane, tmp_path / "text.obj", "--lossy")
    text = (tmp_path / "text.obj").read_bytes()
    cut = tmp_path / "cut.obj"
    cut.write_bytes(text[: len(text) // 4].rsplit(b"\n", 1)[0] + b"\nv 1 x 2\n")
    with pytest.raises(simod.FormatError, match="x"):
        list(simod.open(cut).chunks())


def test_laz_by_itself(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=3, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 5_600_000.0, 100.0]
    las = laspy.LasData(header)
    rng = np.random.default_rng(7)
    xy = rng.uniform(0.0, 100.0, (30_000, 2))
    las.x, las.y = 400_000 + xy[:, 0], 5_600_000 + xy[:, 1]
    las.z = 100 + np.sin(xy[:, 0] / 9)
    path = tmp_path / "scan.laz"
    las.write(str(path))
    model = simod.open(path)
    assert model.info.scale == (0.001, 0.001, 0.001) and "classification" in model.info.attributes
    assert np.allclose(vertices(path), las.xyz, atol=1e-9)
    samples = model.sample(3000)
    samples.points[:, 2] += 5.0
    report = model.apply(samples, tmp_path / "up.laz")
    assert report.vertices == 30_000 and report.output == tmp_path / "up.laz"
    with laspy.open(str(report.output)) as file:
        moved = file.read()
    assert np.allclose(moved.xyz, las.xyz + [0, 0, 5], atol=0.0011)
    assert np.array_equal(moved.red, las.red)
