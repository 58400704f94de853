"""Two builds of the program beside each other: a fixed set of commands on generated models, by both, and what differs.

    python tests/judges/same_bytes.py OLD/target/release target/release

Each folder holds `simod` and its plugins. Models, folders of samples, deformed samples, deformed models, pictures, conversions, what
the units of a plan write, and comparisons are compared byte by byte, what commands print with `--json` key by key. Times, memory and
versions are left out. It ends with 1 if anything differs.
"""

import hashlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

BUILDS = [pathlib.Path(folder).resolve() for folder in sys.argv[1:3]]

# What a run takes, and which program it was, is another one each time.
PASSING = re.compile(r"second|rate|memory|processor|thread|version|machine|program|date|took|resident|hash|fingerprint")

# Tables and pages of comparisons, which hold times, as their JSON tells the rest.
TIMED = {".csv", ".tex", ".html"}

SESSION = """
[model]
path = "{model}"
[sampling]
samples = {samples}
{steps}
[output]
path = "{out}"
"""

REGIONS = """
[[step.region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.6, 0], normal = [0, -1, 0] } }]
[[step.region]]
role = "handle"
shapes = [{ half-space = { point = [0, 1.7, 0], normal = [0, 1, 0] } }]
move = { translate = [0.3, 0.1, 0], axis = [0, 0, -1], degrees = 40, pivot = [0, 1.6, 0] }
"""

BEND = """
[[step]]
deform = "warp"
params = { operation = "bend", angle = 60, direction = [1, 0, 0], center = [0, 0.4, 0], from = 0, to = 0.5 }
"""


def step(deform, params=""):
    return f'[[step]]\ndeform = "{deform}"\n' + (f"params = {{ {params} }}\n" if params else "") + REGIONS


STEPS = {
    "warp": BEND,
    "rbf": step("rbf"),
    "arap": step("laplacian", 'mode = "arap"'),
    "bi-laplacian": step("laplacian", 'mode = "bi-laplacian"'),
    "smooth-handle": step("smooth-handle"),
    "stack": BEND
    + step("rbf")
    + '[[step]]\nrefine = { shapes = [{ sphere = { center = [0, 1.2, 0], radius = 0.3 } }], factor = 4 }\n'
    + BEND,
}

COMPARISON = """
[model]
path = "cactus.ply"
[sampling]
samples = 4000
[[region]]
role = "fixed"
shapes = [{ half-space = { point = [0, 0.4, 0], normal = [0, -1, 0] } }]
[[region]]
role = "handle"
shapes = [{ box = { min = [-0.28, 1.55, -0.3], max = [0.28, 3, 0.3] } }]
move = { translate = [0.4, -0.1, 0] }
[camera]
size = [320, 240]
[[method]]
name = "rigid"
deform = "laplacian"
[[method]]
name = "rbf"
deform = "rbf"
"""

MODELS = {
    "amphora": ["--shape", "amphora", "--vertices", "200000"],
    "cloud": ["--shape", "bumpy-sphere", "--vertices", "150000", "--no-faces", "--no-normals"],
    "bare": ["--shape", "amphora", "--vertices", "100000", "--no-normals", "--encoding", "ascii"],
    "cactus": ["--shape", "cactus", "--vertices", "120000"],
}


def commands():
    """All that is done, in this order: a name, and the words after `simod`."""
    for model, words in MODELS.items():
        yield f"generate {model}", ["generate", *words, "-o", f"{model}.ply"]
        yield f"info {model}", ["info", f"{model}.ply"]
        yield f"sample {model}", ["sample", f"{model}.ply", "-o", f"{model}.simod", "--samples", "6000"]
        yield f"render {model}", ["render", f"{model}.ply", "-o", f"{model}.png", "--size", "400x300"]
    by_error, by_vertices = ["--error", "1e-3", "--place", "faces"], ["--samples", "3000", "--by", "vertices", "--tree", "octree"]
    yield "sample by an error", ["sample", "amphora.ply", "-o", "error.simod", *by_error]
    yield "sample by vertices", ["sample", "cloud.ply", "-o", "vertices.simod", *by_vertices]
    for name, steps in STEPS.items():
        session = pathlib.Path(f"{name}.toml")
        session.write_text(SESSION.format(model="amphora.ply", samples=5000, steps=steps, out=f"{name}-run.ply"))
        yield f"run {name}", ["run", str(session)]
        yield f"render {name}", ["render", f"{name}-run.ply", "-o", f"{name}.png", "--size", "400x300"]
    pathlib.Path("warp-cloud.toml").write_text(SESSION.format(model="cloud.ply", samples=5000, steps=BEND, out="cloud-run.ply"))
    yield "run warp of a cloud", ["run", "warp-cloud.toml"]
    yield "deform", ["deform", "amphora.simod", "--session", "rbf.toml", "-o", "deformed.ply"]
    reconstruct = ["reconstruct", "amphora.simod", "--deformed", "deformed.ply", "-o"]
    for method in ["blended-jets", "projected-barycentric"]:
        yield f"reconstruct by {method}", [*reconstruct, f"{method}.ply", "--method", method]
    yield "reconstruct with diagnostics", [*reconstruct, "told.ply", "--diagnostics", "diagnostics.ply"]
    yield "refine", ["refine", "amphora.simod", "--sphere", "0,1,0,0.4", "--into", "finer.simod", "--factor", "3"]
    for kind in ["las", "laz", "obj", "off", "stl", "pcd", "xyz"]:
        yield f"convert to {kind}", ["convert", "cactus.ply", f"cactus.{kind}", "--lossy"]
    for kind in ["laz", "obj", "stl"]:
        yield f"sample {kind}", ["sample", f"cactus.{kind}", "-o", f"{kind}.simod", "--samples", "4000"]
    yield "plan", ["plan", "warp.toml", "-o", "plan", "--units", "3", "--emit", "make,commands", "--to", "by-units.ply"]
    for number in range(64):
        if pathlib.Path("plan/commands.txt").exists() and number < len(units()):
            yield f"unit {number + 1}", ["unit", "plan", units()[number]]
    pathlib.Path("compare.toml").write_text(COMPARISON)
    yield "compare", ["compare", "compare.toml", "-o", "compared", "--keep-models"]


def units():
    """The numbers of a plan's units, in the order of its stages."""
    lines = pathlib.Path("plan/commands.txt").read_text().splitlines()
    return [line.split()[-1] for line in lines if line and line.split()[-1].isdigit()]


def lasting(value):
    """What of a report does not pass."""
    if isinstance(value, dict):
        told = {key: lasting(inner) for key, inner in value.items() if not PASSING.search(key)}
        return {key: inner for key, inner in told.items() if key != "warnings" or inner}
    if isinstance(value, list):
        # A folder of cargo's has other libraries, too.
        return [lasting(inner) for inner in value if not str(inner).endswith(" is no SIMOD plugin")]
    return value


def differing(old, new, at=""):
    """The keys whose values differ, with both."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from differing(old.get(key), new.get(key), f"{at}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (a, b) in enumerate(zip(old, new)):
            yield from differing(a, b, f"{at}[{i}]")
    elif old != new:
        yield f"{at.lstrip('.')}: {old} -> {new}"


def record(build, folder):
    """All reports of a build, by what was done, and the hashes of all files that it left."""
    os.chdir(folder)
    environment = os.environ | {"SIMOD_PLUGIN_PATH": str(build)}
    reports = {}
    for name, words in commands():
        done = subprocess.run([build / "simod", *words, "--json"], capture_output=True, text=True, env=environment)
        told = lasting(json.loads(done.stdout)) if done.stdout.strip().startswith("{") else {}
        reports[name] = told | {"exit": done.returncode} | ({"error": done.stderr} if done.returncode else {})
    # Units leave each other what they like: the model that they write is compared.
    shutil.rmtree("plan")
    files = sorted(path for path in pathlib.Path(".").rglob("*") if path.is_file() and path.suffix not in TIMED)
    return reports, {str(path): content(path) for path in files}


def content(path):
    """The hash of a file; of a report without what passes."""
    read = path.read_bytes()
    if path.suffix == ".json":
        read = json.dumps(lasting(json.loads(read)), sort_keys=True).encode()
    return hashlib.sha256(read).hexdigest()


def main():
    told = []
    with tempfile.TemporaryDirectory() as folder:
        for build in BUILDS:
            # The same place for both, which some files name.
            work = pathlib.Path(folder, "work")
            work.mkdir()
            told.append(record(build, work))
            os.chdir(folder)
            shutil.rmtree(work)
    (old_reports, old_files), (new_reports, new_files) = told
    failed = [name for name, report in new_reports.items() if report["exit"] != 0]
    print(f"{len(new_reports)} commands, of which {len(failed)} fail with the second build; {len(new_files)} files")
    for name in failed:
        print(f"fails: {name}: {new_reports[name]['error'].strip()}")
    worse = len(failed)
    for name in old_reports.keys() | new_reports.keys():
        for line in differing(old_reports.get(name, {}), new_reports.get(name, {})):
            worse += 1
            print(f"--json of {name}: {line}")
    for name in sorted(old_files.keys() | new_files.keys()):
        if old_files.get(name) != new_files.get(name):
            worse += 1
            print(f"bytes of {name} differ" if name in old_files and name in new_files else f"only one build writes {name}")
    print("nothing differs" if worse == 0 else f"{worse} differences")
    return 1 if worse else 0


sys.exit(main())
