"""The lesson in Python: its scripts do what its page says, on a smaller model."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from conftest import SIMOD

import simod

LESSON = Path(__file__).parents[3] / "examples" / "07-python"


def test_a_scan_corrected_by_numpy(tmp_path: Path) -> None:
    page = (LESSON / "README.md").read_text("utf-8")
    commands = page.split("```sh\n")[1].split("```")[0].splitlines()
    for script in LESSON.glob("*.py"):
        shutil.copy(script, tmp_path)
    make = tmp_path / "make_scan.py"
    make.write_text(make.read_text("utf-8").replace("2000000", "60000").replace("50_000", "8_000"), "utf-8")
    path = os.pathsep.join([str(SIMOD.parent), os.environ["PATH"]])
    for command in commands:
        words = [sys.executable if word == "python3" else word for word in command.split()]
        done = subprocess.run(words, cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "flat.png").stat().st_size > 1000

    def bow(name: str) -> float:
        """The height that the best quadratic surface has over the scan."""
        points = np.concatenate(list(simod.open(tmp_path / name).chunks()))
        x, y, z = (points - points.mean(axis=0)).T
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        heights = terms @ np.linalg.lstsq(terms, z, rcond=None)[0]
        return float(np.ptp(heights))

    assert bow("scan.laz") > 0.5 and bow("flat.laz") < 0.05
