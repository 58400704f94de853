"""The command `simod`: the program that came with the package, beside which its plugins lie."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(__file__).parent / "bin" / ("simod.exe" if os.name == "nt" else "simod")


def main() -> None:
    """Becomes the program."""
    command = [str(PROGRAM), *sys.argv[1:]]
    if os.name == "nt":
        sys.exit(subprocess.run(command).returncode)
    os.execv(PROGRAM, command)
