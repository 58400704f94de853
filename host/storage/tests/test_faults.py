"""Whatever goes wrong on the way and is mended by asking again, changes nothing; what goes wrong for good is told, and
leaves nothing."""

import time
from pathlib import Path

import pytest
from conftest import BUCKET, Local, Store
from faults import CUT, DROPPED, PASSED, REFUSED, SILENT, UNANSWERED, Proxy, at_random


@pytest.mark.parametrize("seed", range(6))
def test_faults_change_no_byte(store: Store, tmp_path: Path, plane: Local, seed: int) -> None:
    url = store.put("plane.ply", plane.path)
    sampled = tmp_path / "plane.simod"
    with Proxy(store.port, at_random(seed)) as proxy:
        store.good("sample", url, "--samples", 3000, "-o", sampled, url=proxy.url)
        write = ("reconstruct", sampled, "--deformed", plane.deformed, "-o", f"s3://{BUCKET}/out.ply")
        store.good(*write, url=proxy.url)
        assert len(proxy.fates()) > 3
    assert (sampled / "samples.ply").read_bytes() == (plane.sampled / "samples.ply").read_bytes()
    assert store.get("out.ply") == plane.output.read_bytes()


@pytest.mark.parametrize("fault", [DROPPED, REFUSED, CUT, SILENT])
def test_a_model_that_never_comes_is_told(store: Store, tmp_path: Path, plane: Local, fault: str) -> None:
    url = store.put("plane.ply", plane.path)
    # The first ones pass, so that it is begun.
    rule = lambda method, path, number: PASSED if number < 6 else fault
    with Proxy(store.port, rule) as proxy:
        begun = time.monotonic()
        told = store.refused("sample", url, "-o", tmp_path / "x.simod", url=proxy.url, AWS_TIMEOUT="2 seconds")
        assert time.monotonic() - begun < 300
    why = {REFUSED: "it answers 503, SlowDown", SILENT: "does not answer in time"}
    assert f"cannot read {url}" in told and why.get(fault, "the connection to the store broke") in told
    assert list(tmp_path.iterdir()) == []


WRITING = [(of, fault) for of in ("first part", "third part") for fault in (DROPPED, REFUSED, UNANSWERED)]
WRITING += [("completion", DROPPED), ("completion", REFUSED)]


@pytest.mark.parametrize("of, fault", WRITING)
def test_an_object_that_cannot_be_written_leaves_nothing(
    store: Store, plane: Local, fault: str, of: str
) -> None:
    def rule(method: str, path: str, number: int) -> str:
        part = {"first part": "partNumber=1&", "third part": "partNumber=3&"}.get(of)
        is_it = part in path if part else method == "POST" and "uploadId=" in path
        return fault if is_it else PASSED

    with Proxy(store.port, rule) as proxy:
        write = ("reconstruct", plane.sampled, "--deformed", plane.deformed, "-o", f"s3://{BUCKET}/out.ply")
        told = store.refused(*write, url=proxy.url)
    assert "cannot write" in told
    assert store.uploads() == [] and store.names() == set()


@pytest.mark.parametrize("fault", [UNANSWERED, CUT])
@pytest.mark.parametrize("times", [1, 100])
def test_a_completion_whose_answer_is_lost_is_one(store: Store, plane: Local, fault: str, times: int) -> None:
    lost = []

    def rule(method: str, path: str, number: int) -> str:
        if method == "POST" and "uploadId=" in path and len(lost) < times:
            lost.append(path)
            return fault
        return PASSED

    with Proxy(store.port, rule) as proxy:
        write = ("reconstruct", plane.sampled, "--deformed", plane.deformed, "-o", f"s3://{BUCKET}/out.ply")
        store.good(*write, url=proxy.url)
    assert lost and store.get("out.ply") == plane.output.read_bytes()


def test_no_server_at_all_is_told(store: Store, tmp_path: Path) -> None:
    told = store.refused("sample", f"s3://{BUCKET}/a.ply", "-o", tmp_path / "x", url="http://127.0.0.1:9")
    assert "cannot be reached" in told and "AWS_ENDPOINT" in told
