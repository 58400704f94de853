"""Models in a store, and behind plain HTTP, are what they are in files."""

import json
import re
import shutil
import ssl
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trustme
from conftest import BUCKET, LARGE, Local, Store, free_port, local
from faults import PASSED, Proxy


def samples(folder: Path) -> list[bytes]:
    """What a sampled model holds, but for the file that says where it came from."""
    return [(folder / name).read_bytes() for name in ("samples.ply", "cells.bin")]


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.laz", "a.obj", "a.stl", "a.pcd", "a.csv"])
def test_every_format_is_read(store: Store, tmp_path: Path, name: str) -> None:
    made = local(tmp_path, name, 20_000)
    url = store.put(f"folder/{name}", made.path)
    facts = [json.loads(store.good("info", "--json", at).out) for at in (made.path, url)]
    for fact in ("vertices", "faces", "bounds", "bytes", "format"):
        assert facts[0][fact] == facts[1][fact]
    into = tmp_path / "of-object.simod"
    store.good("sample", url, "--samples", 3000, "-o", into)
    assert samples(into) == samples(made.sampled)
    output = tmp_path / f"again-{name}"
    store.good("reconstruct", into, "--deformed", made.deformed, "-o", output)
    assert output.read_bytes() == made.output.read_bytes()


def test_blocks_are_read_ahead_and_once(store: Store, tmp_path: Path, plane: Local) -> None:
    url = store.put("plane.ply", plane.path)
    with Proxy(store.port, lambda *_: PASSED) as proxy:
        into = tmp_path / "plane.simod"
        store.good("sample", url, "--samples", 3000, "-o", into, "--threads", 2, url=proxy.url)
        assert samples(into) == samples(plane.sampled)
        blocks = -(-plane.path.stat().st_size // (4 << 20))
        # Sampling reads all of it, some twice or thrice.
        assert blocks > 8 and blocks <= len(proxy.requests) < 5 * blocks


def test_refinement_reads_cells(store: Store, tmp_path: Path, plane: Local) -> None:
    url = store.put("plane.ply", plane.path)
    theirs, ours = tmp_path / "theirs.simod", tmp_path / "ours.simod"
    store.good("sample", url, "--samples", 3000, "-o", theirs)
    store.good("sample", plane.path, "--samples", 3000, "-o", ours)
    before = samples(ours)
    for sampled in (theirs, ours):
        store.good("refine", sampled, "--sphere", "0,0,0,0.2", "--error", "1e-4")
    assert samples(theirs) == samples(ours) != before


def test_what_is_not_there_is_told(store: Store, tmp_path: Path) -> None:
    into = tmp_path / "x.simod"
    for url in (f"s3://{BUCKET}/none.ply", "s3://no-such-bucket/none.ply", f"{store.url}/{BUCKET}/none.ply"):
        assert "there is no such" in store.refused("sample", url, "-o", into)
    for url in ("s3://bucket", "https://host.example"):
        assert "names no object" in store.refused("sample", url, "-o", into)
    store.client.put_object(Bucket=BUCKET, Key="empty.ply", Body=b"")
    assert "is empty" in store.refused("sample", f"s3://{BUCKET}/empty.ply", "-o", into)
    assert not into.exists()


def test_a_model_that_is_replaced_is_noticed(store: Store, tmp_path: Path, plane: Local) -> None:
    url = store.put("plane.ply", plane.path)
    changed = bytearray(plane.path.read_bytes())
    changed[-LARGE] ^= 1

    def replace(method: str, path: str, number: int) -> str:
        if number == 5:
            store.client.put_object(Bucket=BUCKET, Key="plane.ply", Body=bytes(changed))
        return PASSED

    with Proxy(store.port, replace) as proxy:
        told = store.refused("sample", url, "--samples", 3000, "-o", tmp_path / "x.simod", url=proxy.url)
    assert "changed while it was read" in told
    assert list(tmp_path.iterdir()) == []


def test_urls_that_are_signed_are_told_to_nobody(store: Store, tmp_path: Path, plane: Local) -> None:
    store.put("plane.ply", plane.path)
    wanted = {"Bucket": BUCKET, "Key": "plane.ply"}
    signed = store.client.generate_presigned_url("get_object", Params=wanted)
    query = signed.split("?")[1]
    into, output = tmp_path / "plane.simod", tmp_path / "out.ply"
    seen = []

    def see(method: str, path: str, number: int) -> str:
        seen.append(path)
        return PASSED

    with Proxy(store.port, see) as proxy:
        signed = signed.replace(store.url, proxy.url)
        told = store.good("sample", signed, "--samples", 3000, "-o", into, "--json").all
        told += store.good("reconstruct", into, f"--model={signed}", "--deformed", plane.deformed, "-o", output).all
        session = tmp_path / "edit.toml"
        session.write_text(plane.session.read_text().replace('"plane.ply"', f'"{signed}"'))
        told += store.good("run", session, "-o", tmp_path / "ran.ply").all
        told += store.refused("sample", signed.replace("plane", "none"), "-o", tmp_path / "x")
    assert all(query in path for path in seen) and seen
    assert output.read_bytes() == plane.output.read_bytes() == (tmp_path / "ran.ply").read_bytes()
    session.unlink()
    words = re.findall(r"(?:Signature|AWSAccessKeyId)=([^&]+)", query)
    written = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    assert words and not any(word in told or word.encode() in written for word in words)


def test_https_is_read_and_its_certificate_is_looked_at(store: Store, tmp_path: Path, plane: Local) -> None:
    store.put("plane.ply", plane.path)
    authority = trustme.CA()
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("localhost").configure_cert(tls)
    known = tmp_path / "authority.pem"
    authority.cert_pem.write_to_path(str(known))
    into = tmp_path / "plane.simod"
    with Proxy(store.port, lambda *_: PASSED, tls) as proxy:
        url = f"{proxy.url}/{BUCKET}/plane.ply"
        assert "cannot be reached" in store.refused("sample", url, "-o", into)
        store.good("sample", url, "--samples", 3000, "-o", into, SSL_CERT_FILE=str(known))
    assert samples(into) == samples(plane.sampled)


def test_a_server_that_knows_no_ranges_is_refused(tmp_path: Path, store: Store, plane: Local) -> None:
    port = free_port()
    command = [sys.executable, "-m", "http.server", "--bind", "127.0.0.1", "-d", str(plane.path.parent), str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(2)
        told = store.refused("sample", f"http://127.0.0.1:{port}/plane.ply", "-o", tmp_path / "x")
    finally:
        server.terminate()
        server.wait()
    assert "no ranges" in told


def test_tiles_and_sessions_name_objects(store: Store, tmp_path: Path) -> None:
    ours = tmp_path / "ours"
    ours.mkdir()
    urls = []
    for number in range(2):
        made = local(tmp_path, f"{number}.las", 20_000 + number)
        shutil.copy(made.path, ours)
        urls.append(store.put(f"tiles/{number}.las", made.path))
    for name, tiles in (("theirs", urls), ("ours", [str(path) for path in sorted(ours.iterdir())])):
        session = tmp_path / f"{name}.toml"
        session.write_text(
            f"version = 2\n[model]\ntiles = {json.dumps(tiles)}\n[sampling]\nsamples = 2000\n"
            '[[step]]\ndeform = "warp"\nparams = { operation = "twist", angle = 60 }\n'
        )
        store.good("run", session, "-o", tmp_path / f"{name}-out")
    theirs = {path.name: path.read_bytes() for path in (tmp_path / "theirs-out").iterdir()}
    assert theirs == {path.name: path.read_bytes() for path in (tmp_path / "ours-out").iterdir()}
