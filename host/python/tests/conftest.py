"""Models for the tests, made by the program that came with the package."""

import subprocess
import sysconfig
from pathlib import Path

import pytest

SIMOD = Path(sysconfig.get_path("scripts")) / "simod"


def run(*arguments: object) -> str:
    """What the command prints."""
    done = subprocess.run([SIMOD, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bumpy plane of 60 000 vertices with faces and normals."""
    path = tmp_path_factory.mktemp("models") / "plane.ply"
    run("generate", "--shape", "bumpy-plane", "--vertices", 60_000, "-o", path)
    return path


@pytest.fixture(scope="session")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bar of two million vertices: enough work to be stopped."""
    path = tmp_path_factory.mktemp("models") / "bar.ply"
    run("generate", "--shape", "bar", "--vertices", 2_000_000, "-o", path)
    return path
