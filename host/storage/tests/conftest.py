"""A server that speaks S3, and models in it, made by the program that was built with object storage."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import boto3
import pytest

SIMOD = Path(os.environ["SIMOD"])

BUCKET = "models"

KEY, SECRET = "AKIATHENAMEOFTHEKEY", "theSecretThatIsToldToNobody"

# Environment of the program: nothing of this machine's own.
PLAIN = {name: os.environ[name] for name in ("PATH", "HOME", "TMPDIR") if name in os.environ}


@dataclass
class Done:
    code: int
    out: str
    err: str

    @property
    def all(self) -> str:
        return self.out + self.err


class Store:
    """The server, directly."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.url = f"http://127.0.0.1:{port}"
        self.client: Any = boto3.client(
            "s3",
            endpoint_url=self.url,
            aws_access_key_id=KEY,
            aws_secret_access_key=SECRET,
            region_name="us-east-1",
        )

    def put(self, name: str, path: Path) -> str:
        self.client.upload_file(str(path), BUCKET, name)
        return f"s3://{BUCKET}/{name}"

    def get(self, name: str) -> bytes:
        return bytes(self.client.get_object(Bucket=BUCKET, Key=name)["Body"].read())

    def names(self) -> set[str]:
        return {found["Key"] for found in self.client.list_objects_v2(Bucket=BUCKET).get("Contents", [])}

    def uploads(self) -> list[str]:
        """What is begun and not complete."""
        return [begun["Key"] for begun in self.client.list_multipart_uploads(Bucket=BUCKET).get("Uploads", [])]

    def environment(self, url: str | None = None, **more: str) -> dict[str, str]:
        return PLAIN | {
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT": url or self.url,
            "AWS_ALLOW_HTTP": "true",
        } | more

    def start(self, *arguments: object, url: str | None = None, **more: str) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [SIMOD, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment(url, **more),
        )

    def run(self, *arguments: object, url: str | None = None, **more: str) -> Done:
        """What a command does whose store is at `url`; whatever it is, it tells no secret."""
        process = self.start(*arguments, url=url, **more)
        out, err = process.communicate(timeout=600)
        done = Done(process.returncode, out, err)
        assert KEY not in done.all and SECRET not in done.all
        return done

    def good(self, *arguments: object, url: str | None = None, **more: str) -> Done:
        done = self.run(*arguments, url=url, **more)
        assert done.code == 0, done.err
        return done

    def refused(self, *arguments: object, url: str | None = None, **more: str) -> str:
        """The message and the hint of a command that fails."""
        done = self.run(*arguments, url=url, **more)
        assert done.code == 1, done.all
        assert done.err.count("error: ") == 1 and "hint: " in done.err and "panicked" not in done.err
        return done.err


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session")
def server() -> Iterator[Store]:
    port = free_port()
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(600):
            assert process.poll() is None, "the server has ended"
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                time.sleep(0.1)
        yield Store(port)
    finally:
        process.terminate()
        process.wait()


@pytest.fixture
def store(server: Store) -> Iterator[Store]:
    """The server with an empty bucket, in which no test leaves an upload."""
    server.client.create_bucket(Bucket=BUCKET)
    yield server
    left = server.uploads()
    for name in server.names():
        server.client.delete_object(Bucket=BUCKET, Key=name)
    for begun in server.client.list_multipart_uploads(Bucket=BUCKET).get("Uploads", []):
        server.client.abort_multipart_upload(Bucket=BUCKET, Key=begun["Key"], UploadId=begun["UploadId"])
    server.client.delete_bucket(Bucket=BUCKET)
    assert left == []


@dataclass
class Local:
    """A model in a file, and what becomes of it there."""

    path: Path
    sampled: Path
    session: Path
    deformed: Path
    output: Path


def local(folder: Path, name: str, vertices: int, shape: str = "bumpy-plane") -> Local:
    """Of a generated model of a format."""
    extension = name.split(".")[-1]
    at = lambda what: folder / f"{name}.{what}"
    made = Local(folder / name, at("simod"), at("toml"), at("moved.ply"), at(f"out.{extension}"))
    run = lambda *arguments: subprocess.run([SIMOD, *map(str, arguments)], check=True, capture_output=True, env=PLAIN)
    plain = folder / f"{name}.plain.ply"
    run("generate", "--shape", shape, "--vertices", vertices, "-o", plain)
    if extension == "ply":
        plain.rename(made.path)
    else:
        run("convert", "--lossy", plain, made.path)
    made.session.write_text(
        f'[model]\npath = "{name}"\n[sampling]\nsamples = 3000\n'
        '[[step]]\ndeform = "warp"\nparams = { operation = "twist", angle = 60 }\n'
    )
    run("sample", made.path, "--samples", 3000, "-o", made.sampled)
    run("deform", made.sampled, "--session", made.session, "-o", made.deformed)
    run("reconstruct", made.sampled, "--deformed", made.deformed, "-o", made.output)
    return made


# Several blocks of what is read, and several parts of what is written.
LARGE = 1_500_000


@pytest.fixture(scope="session")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Local:
    return local(tmp_path_factory.mktemp("plane"), "plane.ply", LARGE)
