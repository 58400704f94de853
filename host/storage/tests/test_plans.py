"""Units of a plan send parts of one object, each its own, and the last one puts it in its place."""

import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import BUCKET, Local, Store, local
from faults import Proxy, at_random

PART = 8 << 20


def plan(store: Store, made: Local, folder: Path, units: int, name: str, *more: str) -> list[dict[str, Any]]:
    """The units of a plan whose output is an object."""
    store.good("plan", made.session, "--units", units, "-o", folder, "--to", f"s3://{BUCKET}/{name}", *more)
    return list(tomllib.loads((folder / "plan.toml").read_text())["unit"])


def do(store: Store, folder: Path, units: list[dict[str, Any]], url: str | None = None) -> None:
    for unit in units:
        store.good("unit", folder, unit["number"], url=url)


def of_stage(units: list[dict[str, Any]], stage: str) -> list[dict[str, Any]]:
    return [unit for unit in units if unit["stage"] == stage]


def test_units_send_parts_of_one_object(store: Store, tmp_path: Path, plane: Local) -> None:
    folder = tmp_path / "plan"
    units = plan(store, plane, folder, 3, "out.ply")
    before = [unit for unit in units if unit["stage"] not in ("apply", "finish")]
    do(store, folder, before)
    assert store.uploads() == ["out.ply"]
    # In any order, and twice.
    for unit in reversed(of_stage(units, "apply")):
        do(store, folder, [unit, unit])
    assert store.names() == set() and store.uploads() == ["out.ply"]
    begun = store.client.list_multipart_uploads(Bucket=BUCKET)["Uploads"][0]
    sent = store.client.list_parts(Bucket=BUCKET, Key="out.ply", UploadId=begun["UploadId"])["Parts"]
    assert len(sent) >= 2 and all(part["Size"] == PART for part in sent)
    # Units keep the bytes of parts that they share with their neighbours.
    kept = sum(path.stat().st_size for path in folder.glob("part-*.bin"))
    all_sent = sum(part["Size"] for part in sent)
    assert 0 <= kept + all_sent - plane.output.stat().st_size < 1 << 20
    assert not (folder / "output.bin").exists()

    ready = tmp_path / "ready"
    shutil.copytree(folder, ready)
    do(store, folder, of_stage(units, "finish"))
    assert store.get("out.ply") == plane.output.read_bytes()
    assert store.uploads() == []
    assert not any(path.name.startswith(("part-", "upload")) for path in folder.iterdir())
    # As if it had been killed when the object was in its place, and nobody had been told.
    do(store, ready, of_stage(units, "finish"))
    assert store.get("out.ply") == plane.output.read_bytes()
    # Nothing is done again.
    do(store, folder, units)


def test_an_upload_that_is_gone_is_told(store: Store, tmp_path: Path, plane: Local) -> None:
    folder = tmp_path / "plan"
    units = plan(store, plane, folder, 2, "out.ply")
    do(store, folder, units[:-1])
    begun = store.client.list_multipart_uploads(Bucket=BUCKET)["Uploads"][0]
    store.client.abort_multipart_upload(Bucket=BUCKET, Key="out.ply", UploadId=begun["UploadId"])
    store.client.put_object(Bucket=BUCKET, Key="out.ply", Body=plane.path.read_bytes())
    # By S3 there is no such upload; this server fails.
    assert "cannot write" in store.refused("unit", folder, units[-1]["number"])
    assert store.get("out.ply") == plane.path.read_bytes()


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.laz", "a.stl", "a.obj"])
def test_ranges_that_are_shorter_than_parts(store: Store, tmp_path: Path, name: str) -> None:
    made = local(tmp_path, name, 60_000)
    units = plan(store, made, tmp_path / "plan", 3, name)
    do(store, tmp_path / "plan", units)
    assert store.get(name) == made.output.read_bytes()
    assert store.uploads() == []


def test_parts_are_compressed_and_large(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.laz", 2_500_000)
    assert made.output.stat().st_size > PART
    do(store, tmp_path / "plan", plan(store, made, tmp_path / "plan", 3, "a.laz"))
    assert store.get("a.laz") == made.output.read_bytes()


def test_a_plan_that_is_made_anew_leaves_nothing_of_the_former(store: Store, tmp_path: Path, plane: Local) -> None:
    folder = tmp_path / "plan"
    units = plan(store, plane, folder, 2, "out.ply")
    do(store, folder, units[:-1])
    assert store.uploads() == ["out.ply"]
    units = plan(store, plane, folder, 3, "other.ply")
    assert store.uploads() == []
    do(store, folder, units)
    assert store.names() == {"other.ply"} and store.get("other.ply") == plane.output.read_bytes()


def test_a_model_that_changed_is_not_written(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 60_000)
    url = store.put("a.ply", made.path)
    folder = tmp_path / "plan"
    units = plan(store, made, folder, 2, "out.ply", "--model", url)
    do(store, folder, units[:-1])
    changed = bytearray(made.path.read_bytes())
    changed[2000] ^= 1
    store.client.put_object(Bucket=BUCKET, Key="a.ply", Body=bytes(changed))
    told = store.refused("unit", folder, units[-1]["number"])
    assert "of another model" in told
    assert store.names() == {"a.ply"}
    assert given_up(store, folder)
    # As it was, it is written after all.
    store.put("a.ply", made.path)
    assert "(deform) has to be done" in store.refused("unit", folder, of_stage(units, "apply")[0]["number"])
    do(store, folder, [*of_stage(units, "deform"), *of_stage(units, "apply"), units[-1]])
    assert store.get("out.ply") == made.output.read_bytes()


def test_a_model_that_is_not_what_was_sampled_is_not_written(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 60_000)
    folder = tmp_path / "plan"
    units = plan(store, made, folder, 2, "out.ply")
    do(store, folder, [unit for unit in units if unit["stage"] not in ("apply", "finish")])
    changed = bytearray(made.path.read_bytes())
    changed[2000] ^= 1
    made.path.write_bytes(changed)
    do(store, folder, of_stage(units, "apply"))
    assert store.uploads() == ["out.ply"]
    assert "changed since it was sampled" in store.refused("unit", folder, units[-1]["number"])
    assert store.names() == set()
    assert given_up(store, folder)


def test_a_part_that_is_damaged_is_sent_again_alone(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 60_000)
    folder = tmp_path / "plan"
    units = plan(store, made, folder, 2, "out.ply")
    do(store, folder, units[:-1])
    part = folder / "part-1.bin"
    part.write_bytes(part.read_bytes()[:-20])
    assert "is damaged" in store.refused("unit", folder, units[-1]["number"])
    assert store.uploads() == ["out.ply"] and (folder / "part-0.bin").exists()
    part.unlink()
    do(store, folder, [of_stage(units, "apply")[1], units[-1]])
    assert store.get("out.ply") == made.output.read_bytes()


def given_up(store: Store, folder: Path) -> bool:
    """Nothing is left of what units have sent, nor of what says so."""
    left = [path.name for path in folder.iterdir() if path.name.startswith(("part-", "upload", "deformed"))]
    return store.uploads() == [] and left == []


@pytest.mark.parametrize("seed", range(2))
def test_faults_change_no_byte(store: Store, tmp_path: Path, plane: Local, seed: int) -> None:
    url = store.put("plane.ply", plane.path)
    folder = tmp_path / "plan"
    units = plan(store, plane, folder, 2, "out.ply", "--model", url)
    with Proxy(store.port, at_random(100 + seed)) as proxy:
        do(store, folder, units, proxy.url)
    assert store.get("out.ply") == plane.output.read_bytes()
