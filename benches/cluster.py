#!/usr/bin/env python3
"""What units cost, and what a cluster makes of them: measured, simulated, and compared.

    python3 benches/cluster.py measure SESSION.toml --units 4 -o costs.json
    python3 benches/cluster.py simulate costs.json --vertices 1e10 --machines 1,100,1000
    python3 benches/cluster.py compare SESSION.toml --units 8 --workers 1,2      (needs simod.dask)

`measure` does the units of a plan one by one, each by one thread, and notes seconds, bytes and memory of each stage.
`simulate` replays them on machines that share a file system: each takes the next unit of a stage, one unit for each core
where the stage has as many; some are slower than others, some die and come back. A stage begins when the one before is
over, as units of a plan need. `compare` does the same for the workers of a LocalCluster, which it then lets do them.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path

PROGRAM = Path(__file__).parent.parent / "target" / "release" / "simod"


@dataclass
class Cost:
    """What a stage costs, by what was measured."""

    stage: str
    units: int
    divides: bool
    """Whether each unit has a share of the vertices."""
    seconds: float
    """Of one processor, of all units together, without what each costs to begin with."""
    seconds_a_unit: float
    """What each unit costs besides: what all have to read and prepare."""
    peak: int
    """Bytes of memory of the largest unit."""


SHARED_BYTES = 17
"""Bytes that are written down of a vertex at most, as a rule, where it has no normal."""

DIVIDED = {"count", "cluster", "cluster-shared", "members", "faces", "apply"}


def command(*arguments: object) -> tuple[float, int, str]:
    """Processor time, memory and output of the program."""
    child = subprocess.Popen([PROGRAM, "--json", *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    text = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"{arguments}: the program failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024, text


def planned(session: Path, units: int, folder: Path) -> tuple[Path, list[dict[str, object]], dict[str, object]]:
    plan = folder / "plan"
    suffix = Path(tomllib.loads(session.read_text())["model"]["path"]).suffix
    command("plan", session, "-o", plan, "--units", units, "--to", folder / f"out{suffix}")
    content = tomllib.loads((plan / "plan.toml").read_text())
    return plan, content["unit"], content


def measured(session: Path, units: int) -> dict[str, object]:
    """The costs of the stages of a session: by so many units, and by four times as many, as what a stage takes is
    that of its work and of its units."""
    few, more = once(session, units), once(session, 4 * units)
    costs = []
    for stage, (count, seconds, peak) in few["stages"].items():
        other, others, _ = more["stages"].get(stage, (count, seconds, peak))
        begin = max(0.0, (others - seconds) / (other - count)) if other > count else 0.0
        if stage == "cluster-shared":
            # What it has to do grows with the number of ranges that share cells.
            begin = 0.0
        costs.append(
            asdict(Cost(stage, count, stage in DIVIDED, max(0.0, seconds - count * begin), begin, peak))
        )
    return {**few, "stages": costs}


def once(session: Path, units: int) -> dict[str, object]:
    """What the stages take: number of units, seconds of a processor, and the most memory of one."""
    with tempfile.TemporaryDirectory(dir=session.parent) as name:
        plan, todo, content = planned(session, units, Path(name))
        stages: dict[str, tuple[int, float, int]] = {}
        exchanged = shared = 0
        for unit in todo:
            seconds, peak, _ = command("--threads", 1, "unit", plan, unit["number"])
            before = stages.get(str(unit["stage"]), (0, 0.0, 0))
            stages[str(unit["stage"])] = (before[0] + 1, before[1] + seconds, max(before[2], peak))
            if unit["stage"] == "cut":
                size = {file.name: file.stat().st_size for file in plan.iterdir()}
                trees = [size[name] for name in size if name.startswith(("cluster-", "group-"))]
                shared = sum(size[name] for name in size if name.startswith("shared-"))
                exchanged = shared + sum(trees)
        return {
            "vertices": content["vertices"],
            "bytes": content["model-bytes"],
            "exchanged": exchanged,
            "shared": shared,
            "stages": stages,
        }


@dataclass
class Machines:
    """What does the units."""

    number: int
    cores: int
    bandwidth: float
    """Bytes a second that a machine reads or writes."""
    slow: float = 0.0
    """Part of the machines that are `slowness` times slower."""
    slowness: float = 20.0
    failures: float = 0.0
    """How often a machine dies, in an hour; it is back after `away` seconds."""
    away: float = 30.0


def simulated(costs: dict[str, object], vertices: float, units: int, on: Machines, seed: int = 1) -> dict[str, float]:
    """Wall seconds of each stage."""
    chance = random.Random(seed)
    scale = vertices / float(costs["vertices"])
    model_bytes = float(costs["bytes"]) * scale
    # Ranges share cells along their borders, until no cell is of one range alone.
    borders = max(1, next(stage["units"] for stage in costs["stages"]) - 1)
    shared = float(costs["shared"])
    all_shared = max(shared, SHARED_BYTES * float(costs["vertices"]))
    more = min(all_shared / shared, (units - 1) / borders) if shared > 0 else 0.0
    slow = [chance.random() < on.slow for _ in range(on.number)]
    now, walls = 0.0, {}
    for stage in costs["stages"]:
        count = units if stage["divides"] else 1
        work = stage["seconds"] * (scale if stage["divides"] else 1.0)
        # Of meshes, all readings but that of the faces, which is twice, are of the vertices: about a third of the file.
        reads = {"count": 1.0, "cluster": 1.0, "faces": 1.4, "apply": 2.0, "sample": 1.0}.get(stage["stage"], 0.0)
        moved = reads * model_bytes
        if stage["stage"] in ("sample", "complete"):
            work = stage["seconds"] * scale
        if stage["stage"] in ("cluster", "cluster-shared"):
            moved += shared * more * scale
        if stage["stage"] == "cluster-shared":
            work *= more
        # Each unit uses all cores of its machine.
        seconds = max(work / count / on.cores, moved / count / on.bandwidth)
        seconds += stage["seconds_a_unit"] if stage["divides"] else 0.0
        walls[stage["stage"]] = replayed(count, seconds, on, slow, chance)
        now += walls[stage["stage"]]
    walls["all"] = now
    return walls


def replayed(count: int, seconds: float, on: Machines, slow: list[bool], chance: random.Random) -> float:
    """When the last of so many units is done, each of which takes so long on a machine that is as others are."""
    free = [(0.0, machine) for machine in range(on.number)]
    heapq.heapify(free)
    todo, end = count, 0.0
    lost: list[float] = []
    while todo > 0 or lost:
        start, machine = heapq.heappop(free)
        if todo == 0:
            # Nothing to do but what others will have lost by then.
            again = min(lost)
            lost.remove(again)
            start, todo = max(start, again), 1
        took = seconds * (on.slowness if slow[machine] else 1.0)
        dies = chance.expovariate(on.failures / 3600) if on.failures > 0 else math.inf
        todo -= 1
        if dies < took:
            lost.append(start + dies)
            heapq.heappush(free, (start + dies + on.away, machine))
        else:
            end = max(end, start + took)
            heapq.heappush(free, (start + took, machine))
    return end


def compared(session: Path, units: int, workers: list[int]) -> None:
    """Predictions beside what a LocalCluster takes."""
    import distributed

    import simod.dask

    # Workers of one thread each: by as many cores as there are.
    os.environ["RAYON_NUM_THREADS"] = "1"
    costs = measured(session, units)
    print("| workers | predicted, s | measured, s | ratio |\n|---:|---:|---:|---:|")
    for number in workers:
        cores = min(1.0, (os.cpu_count() or 1) / number)
        on = Machines(number, 1, 1e12)
        expected = simulated(costs, float(costs["vertices"]), units, on)["all"] / cores
        suffix = Path(tomllib.loads(session.read_text())["model"]["path"]).suffix
        with (
            tempfile.TemporaryDirectory(dir=session.parent) as folder,
            distributed.LocalCluster(n_workers=number, threads_per_worker=1, dashboard_address=":0") as cluster,
            distributed.Client(cluster) as client,
        ):
            client.wait_for_workers(number)
            # What is imported first, and found, is none of the units'.
            client.run(lambda: __import__("simod.dask"))
            start = time.monotonic()
            simod.dask.run(client, session, Path(folder) / f"out{suffix}", units=units)
            took = time.monotonic() - start
        print(f"| {number} | {expected:.1f} | {took:.1f} | {took / expected:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("measure")
    one.add_argument("session", type=Path)
    one.add_argument("--units", type=int, default=4)
    one.add_argument("-o", "--output", type=Path)
    one = commands.add_parser("simulate")
    one.add_argument("costs", type=Path)
    one.add_argument("--vertices", default="1e10,1e12")
    one.add_argument("--machines", default="1,100,1000")
    one.add_argument("--cores", type=int, default=16)
    one.add_argument("--bandwidth", type=float, default=1e9)
    one.add_argument("--units-each", type=int, default=4, help="units for each machine")
    one.add_argument("--slow", type=float, default=0.0)
    one.add_argument("--slowness", type=float, default=20.0)
    one.add_argument("--failures", type=float, default=0.0, help="deaths of a machine in an hour")
    one = commands.add_parser("compare")
    one.add_argument("session", type=Path)
    one.add_argument("--units", type=int, default=8)
    one.add_argument("--workers", default="1,2")
    given = parser.parse_args()
    if given.command == "measure":
        text = json.dumps(measured(given.session, given.units), indent=1)
        given.output.write_text(text) if given.output else print(text)
    elif given.command == "simulate":
        costs = json.loads(given.costs.read_text())
        stages = [stage["stage"] for stage in costs["stages"]]
        print("| vertices | machines | " + " | ".join([*stages, "all"]) + " |")
        print("|---:|---:|" + "---:|" * (len(stages) + 1))
        for vertices in map(float, given.vertices.split(",")):
            for number in map(int, given.machines.split(",")):
                on = Machines(number, given.cores, given.bandwidth, given.slow, given.slowness, given.failures)
                walls = simulated(costs, vertices, min(number * given.units_each, 1000), on)
                print(f"| {vertices:.0e} | {number} | " + " | ".join(f"{s:.0f} s" for s in walls.values()) + " |")
    else:
        compared(given.session, given.units, [int(n) for n in given.workers.split(",")])


if __name__ == "__main__":
    main()
