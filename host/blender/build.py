#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the extension's zip: build.py [FOLDER]; the folder is this one unless given."""

import sys
import tomllib
import zipfile
from pathlib import Path

HERE = Path(__file__).parent


def build(folder: Path) -> Path:
    """Writes the zip; the same bytes each time."""
    manifest = tomllib.loads((HERE / "blender_manifest.toml").read_text("utf-8"))
    path = folder / f"{manifest['id']}-{manifest['version']}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ["blender_manifest.toml", *manifest["build"]["paths"]]:
            file.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), (HERE / name).read_bytes())
    return path


if __name__ == "__main__":
    print(build(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE))
