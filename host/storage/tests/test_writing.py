"""What is written to a store has the bytes of a file, and is there whole or not at all."""

import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BUCKET, SIMOD, Local, Store, local
from faults import PASSED, Proxy


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.laz", "a.obj"])
def test_every_format_is_written(store: Store, tmp_path: Path, name: str) -> None:
    made = local(tmp_path, name, 20_000)
    url = f"s3://{BUCKET}/out/{name}"
    store.good("reconstruct", made.sampled, "--deformed", made.deformed, "-o", url)
    assert store.get(f"out/{name}") == made.output.read_bytes()
    store.good("run", made.session, "-o", url)
    assert store.get(f"out/{name}") == made.output.read_bytes()
    store.good("convert", "--lossy", made.output, f"s3://{BUCKET}/converted.{name}")
    subprocess.run([SIMOD, "convert", "--lossy", made.output, tmp_path / f"converted.{name}"], check=True)
    assert store.get(f"converted.{name}") == (tmp_path / f"converted.{name}").read_bytes()
    assert store.uploads() == []


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
def test_what_comes_last_stands_at_the_beginning(store: Store, tmp_path: Path, name: str) -> None:
    """Bounds, and the place of a table behind all points, in more than two parts."""
    made = local(tmp_path, name, 1_200_000 if name == "a.las" else 4_000_000)
    assert made.output.stat().st_size > 17 << 20
    store.good("reconstruct", made.sampled, "--deformed", made.deformed, "-o", f"s3://{BUCKET}/{name}")
    assert store.get(name) == made.output.read_bytes()


def test_a_large_model_goes_from_store_to_store(store: Store, tmp_path: Path, plane: Local) -> None:
    url = store.put("plane.ply", plane.path)
    sampled = tmp_path / "plane.simod"
    store.good("sample", url, "--samples", 3000, "-o", sampled)
    store.good("reconstruct", sampled, "--deformed", plane.deformed, "-o", f"s3://{BUCKET}/out.ply")
    assert store.get("out.ply") == plane.output.read_bytes()
    parts = store.client.head_object(Bucket=BUCKET, Key="out.ply", PartNumber=1)["PartsCount"]
    assert parts == -(-plane.output.stat().st_size // (8 << 20)) > 2
    assert store.uploads() == []


def test_outputs_replace_what_they_may(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 20_000)
    url = store.put("a.ply", made.path)
    into = tmp_path / "b.simod"
    store.good("sample", url, "--samples", 3000, "-o", into)
    write = ("reconstruct", into, "--deformed", made.deformed, "-o")
    assert "is the model itself" in store.refused(*write, url)
    assert store.get("a.ply") == made.path.read_bytes()
    store.client.put_object(Bucket=BUCKET, Key="letter.ply", Body=b"dear reader")
    letter = f"s3://{BUCKET}/letter.ply"
    assert "is no model" in store.refused(*write, letter)
    assert store.get("letter.ply") == b"dear reader"
    store.good(*write, letter, "--force")
    assert store.get("letter.ply") == made.output.read_bytes()
    # A model is replaced by another one.
    store.good(*write, letter)


def test_what_is_not_written_to_a_store_is_refused(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 20_000)
    url = f"s3://{BUCKET}/x"
    write = ("reconstruct", made.sampled, "--deformed", made.deformed)
    assert "--resume" in store.refused(*write, "-o", f"{url}.ply", "--resume")
    assert "here a file is needed" in store.refused(*write, "-o", tmp_path / "o.ply", "--diagnostics", f"{url}.ply")
    assert "here a file is needed" in store.refused("sample", made.path, "-o", f"{url}.simod")
    assert "here a file is needed" in store.refused("render", made.path, "-o", f"{url}.png")
    assert "can only be read" in store.refused(*write, "-o", f"{store.url}/{BUCKET}/x.ply")
    session = tmp_path / "stranger.toml"
    session.write_text(made.session.read_text() + f'[output]\npath = "{url}.ply"\n')
    assert "by itself writes beside itself" in store.refused("run", session)
    assert store.names() == set() and not (tmp_path / "o.ply").exists()


def test_several_versions_are_written(store: Store, tmp_path: Path) -> None:
    made = local(tmp_path, "a.ply", 20_000)
    pattern = tmp_path / "moved-*.ply"
    for number in range(3):
        (tmp_path / f"moved-{number}.ply").write_bytes(made.deformed.read_bytes())
    store.good("reconstruct", made.sampled, "--deformed", pattern, "-o", f"s3://{BUCKET}/o-{{}}.ply")
    assert store.names() == {"o-0.ply", "o-1.ply", "o-2.ply"}
    assert store.get("o-2.ply") == made.output.read_bytes()


def test_nothing_is_left_of_what_is_stopped(store: Store, tmp_path: Path, plane: Local) -> None:
    stopped = 0
    for parts_before in (0, 1, 2):
        begun = []

        def watch(method: str, path: str, number: int) -> str:
            if method in ("PUT", "POST"):
                begun.append(path)
                time.sleep(0.3)
            return PASSED

        with Proxy(store.port, watch) as proxy:
            write = ("reconstruct", plane.sampled, "--deformed", plane.deformed, "-o", f"s3://{BUCKET}/out.ply")
            process = store.start(*write, url=proxy.url)
            while len(begun) <= parts_before and process.poll() is None:
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
            stopped += process.returncode == 130
            assert process.returncode in (0, 130), err
        assert store.uploads() == []
        if process.returncode == 130:
            assert "cancelled" in err and store.names() == set()
        else:
            store.client.delete_object(Bucket=BUCKET, Key="out.ply")
    assert stopped > 0
