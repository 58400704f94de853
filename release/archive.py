#!/usr/bin/env python3
"""Makes one archive of a release: archive.py [FOLDER]

The program, the window and the plugins; completions and manual pages, which the program makes; what makes a desktop (of
Linux) open sessions in the window; documents and lessons; and the licences of all that is linked in. Comes after `cargo
build --release` and `cargo build --release -p simod-window`; the window is left out, and that is said, where it was not
built. The archive goes to FOLDER, which is target/ unless given.
"""

import io
import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BUILT = TARGET / "release"
EXE, BEFORE, AFTER = {
    "win32": (".exe", "", ".dll"),
    "darwin": ("", "lib", ".dylib"),
}.get(sys.platform, ("", "lib", ".so"))
SHELLS = {"bash": "simod", "zsh": "_simod", "fish": "simod.fish", "powershell": "simod.ps1"}
LICENCES = ("LICENSE", "LICENCE", "COPYING", "NOTICE", "UNLICENSE", "COPYRIGHT")


def output(*command: object) -> str:
    """What a command prints."""
    return subprocess.run([str(c) for c in command], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def licences(platform: str, programs: list[str]) -> str:
    """Name, version, licence and its text for each package that is linked in."""
    metadata = json.loads(output("cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", platform))
    packages = {package["id"]: package for package in metadata["packages"]}
    uses = {
        node["id"]: [d["pkg"] for d in node["deps"] if any(k["kind"] is None for k in d["dep_kinds"])]
        for node in metadata["resolve"]["nodes"]
    }
    names = {package["name"]: id for id, package in packages.items() if id in metadata["workspace_members"]}
    found, left = set(), [names[program] for program in programs]
    while left:
        id = left.pop()
        if id not in found:
            found.add(id)
            left += uses[id]
    parts = ["What is linked into SIMOD, and under which licences.\n"]
    for id in sorted(found - set(metadata["workspace_members"]), key=lambda id: (packages[id]["name"], id)):
        package = packages[id]
        folder = Path(package["manifest_path"]).parent
        files = sorted(p for p in folder.iterdir() if p.is_file() and p.name.upper().startswith(LICENCES))
        parts.append(f"\n{'=' * 80}\n{package['name']} {package['version']}: {package['license'] or 'see below'}\n")
        parts += [f"\n-- {path.name}\n\n{path.read_text('utf-8', 'replace').strip()}\n" for path in files]
    return "".join(parts)


def main(folder: Path) -> None:
    version = output(BUILT / f"simod{EXE}", "--version").split()[-1]
    platform = next(line[6:] for line in output("rustc", "-vV").splitlines() if line.startswith("host: "))
    name = f"simod-{version}-{platform}"
    plugins = sorted(path.parent.name for path in ROOT.glob("plugins/*/Cargo.toml"))
    programs = ["simod-cli", *(f"simod-plugin-{plugin}" for plugin in plugins)]
    content: dict[str, bytes] = {f"bin/simod{EXE}": (BUILT / f"simod{EXE}").read_bytes()}
    window = BUILT / f"simod-viewer{EXE}"
    if window.exists():
        content[f"bin/{window.name}"] = window.read_bytes()
        programs.append("simod-window")
    else:
        print(f"without the window: {window} is not there", file=sys.stderr)
    for plugin in plugins:
        file = f"{BEFORE}simod_{plugin.replace('-', '_')}{AFTER}"
        content[f"bin/plugins/{file}"] = (BUILT / file).read_bytes()
    for shell, file in SHELLS.items():
        content[f"share/completions/{file}"] = output(BUILT / f"simod{EXE}", "completions", shell).encode()
    content["share/applications/simod.desktop"] = (ROOT / "release/simod.desktop").read_bytes()
    content["share/mime/packages/simod.xml"] = (ROOT / "release/simod.xml").read_bytes()
    pages = folder / f".{name}-pages"
    output(BUILT / f"simod{EXE}", "manual", "-o", pages)
    for page in sorted(pages.iterdir()):
        content[f"share/man/man1/{page.name}"] = page.read_bytes()
        page.unlink()
    pages.rmdir()
    kept = output("git", "ls-files", "docs", "examples", "README.md", "CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT")
    content |= {file: (ROOT / file).read_bytes() for file in kept.splitlines()}
    content["LICENSES-OF-DEPENDENCIES"] = licences(platform, programs).encode()

    path = folder / f"{name}.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for file, data in sorted(content.items()):
            entry = tarfile.TarInfo(f"{name}/{file}")
            entry.size, entry.mode = len(data), 0o755 if file.startswith("bin/") else 0o644
            archive.addfile(entry, io.BytesIO(data))
    print(f"{path}: {len(content)} files, {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else TARGET)
