#!/usr/bin/env python3
"""What units cost, and what a cluster makes of them: measured, simulated, and compared.

    python3 benches/cluster.py measure SESSION.toml --units 4 -o costs.json
    python3 benches/cluster.py simulate costs.json --vertices 1e10 --machines 1,100,1000
    python3 benches/cluster.py compare SESSION.toml --units 8 --workers 1,2      (needs simod.dask)
    python3 benches/cluster.py compare SESSION.toml --workers 4,8 --vertices 2e8 --slow 0.25 --slowness 5 --failures 120
    python3 benches/cluster.py overhead SESSION.toml --units 4 --workers 2 --threads 1,2 --runs 3
    python3 benches/cluster.py kill SESSION.toml --units 8 --workers 3 --kills 100

`measure` does the units of a plan one by one, each by one thread, and notes seconds, bytes and memory of each stage.
`simulate` replays them on machines that share a file system: each takes the next unit of a stage, one unit for each core
where the stage has as many; some are slower than others, some die and come back. A stage begins when the one before is
over, as units of a plan need. `compare` does the same for the workers of a LocalCluster, which it then lets do them:
some of them are made slower, and are killed, as is simulated. What other programs take of the machine is told by how long
units take one by one, beside their processor time. With `--vertices`, workers sleep for as long as units of such a model would
take: so more workers than there are cores can be tried, and what the scheduler makes of stragglers and failures is all that is
compared. `overhead` has the plain command and the workers of a LocalCluster that is running do a session in turns, by the clock,
which tells something on a quiet machine alone; units get so many threads each. `kill` runs a session until so many workers were killed, and looks whether
each output has the bytes of one machine, and whether anything is left beside it.
"""

from __future__ import annotations

import argparse
import hashlib
import heapq
import json
import math
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from dataclasses import asdict, dataclass, replace
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
    took, _, peak, text = timed(*arguments)
    return took, peak, text


def timed(*arguments: object) -> tuple[float, float, int, str]:
    """Processor time, wall time, memory and output of the program."""
    start = time.monotonic()
    child = subprocess.Popen([PROGRAM, "--json", *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    text = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"{arguments}: the program failed")
    wall = time.monotonic() - start
    return usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss * 1024, text


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
        walls = 0.0
        for unit in todo:
            seconds, wall, peak, _ = timed("--threads", 1, "unit", plan, unit["number"])
            walls += wall
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
            "stretch": walls / sum(seconds for _, seconds, _ in stages.values()),
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


def stages(costs: dict[str, object], vertices: float, units: int, on: Machines) -> list[tuple[str, int, float]]:
    """The stages, how many units each has, and how many seconds one takes on a machine that is as others are."""
    scale = vertices / float(costs["vertices"])
    model_bytes = float(costs["bytes"]) * scale
    # Ranges share cells along their borders, until no cell is of one range alone.
    borders = max(1, next(stage["units"] for stage in costs["stages"]) - 1)
    shared = float(costs["shared"])
    all_shared = max(shared, SHARED_BYTES * float(costs["vertices"]))
    more = min(all_shared / shared, (units - 1) / borders) if shared > 0 else 0.0
    found = []
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
        found.append((stage["stage"], count, seconds))
    return found


def simulated(costs: dict[str, object], vertices: float, units: int, on: Machines, seed: int = 1) -> dict[str, float]:
    """Wall seconds of each stage."""
    chance = random.Random(seed)
    slow = [machine < on.slow * on.number for machine in range(on.number)]
    walls = {
        stage: replayed(count, seconds, on, slow, chance)
        for stage, count, seconds in stages(costs, vertices, units, on)
    }
    return walls | {"all": sum(walls.values())}


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


def compared(session: Path, units: int, numbers: list[int], runs: int, vertices: float, how: Machines) -> None:
    """Predictions beside what a LocalCluster takes, the median of some runs and the quickest and slowest one."""
    # Workers of one thread each: by as many cores as there are.
    os.environ["RAYON_NUM_THREADS"] = "1"
    print("| workers | predicted, s | measured, s | from | to | killed | away, s | ratio |")
    print("|---:|---:|---:|---:|---:|---:|---:|---:|")
    # What a unit and a vertex cost does not depend on the number of units.
    costs = measured(session, min(units, 4))
    for number in numbers:
        on = replace(how, number=number)
        all_vertices = vertices or float(costs["vertices"])
        seconds = {stage: took for stage, _, took in stages(costs, all_vertices, units, on)}
        found = [cluster_run(session, units, on, seconds if vertices else None) for _ in range(runs)]
        killed = sum(run.killed for run in found)
        away = sum(run.missed for run in found) / killed if killed else 0.0
        # Of failures, the mean of many.
        seeds = range(200 if how.failures > 0 else 1)
        walls = [simulated(costs, all_vertices, units, replace(on, away=away), seed)["all"] for seed in seeds]
        expected = statistics.fmean(walls)
        if not vertices:
            # Other programs have taken of the cores what they took while units were done one by one.
            expected *= float(costs["stretch"]) * max(1.0, number / (os.cpu_count() or 1))
        took = [run.seconds for run in found]
        middle = statistics.median(took)
        print(
            f"| {number} | {expected:.1f} | {middle:.1f} | {min(took):.1f} | {max(took):.1f} | {killed} | {away:.1f} "
            f"| {middle / expected:.2f} |",
            flush=True,
        )


@dataclass
class Run:
    """What a LocalCluster did."""

    seconds: float
    killed: int
    missed: float
    """Seconds that workers were away, of all of them together."""
    digest: str
    """The hash of the output."""


def cluster_run(session: Path, units: int, on: Machines, asleep: dict[str, float] | None = None) -> Run:
    """Has a LocalCluster do a session, some of whose workers are slower or killed. Where it is asleep, units take these
    seconds of a stage each, and do nothing."""
    import dask
    import distributed

    import simod.dask

    suffix = Path(tomllib.loads(session.read_text())["model"]["path"]).suffix
    over, killed, missed = threading.Event(), 0, 0.0
    with (
        tempfile.TemporaryDirectory(dir=session.parent) as folder,
        dask.config.set({"distributed.scheduler.allowed-failures": 100}),
        distributed.LocalCluster(n_workers=on.number, threads_per_worker=1, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as client,
    ):
        client.wait_for_workers(on.number)
        # What is imported first, and found, is none of the units'.
        client.run(lambda: __import__("simod.dask"))
        client.register_plugin(manner(on.slow * on.number, on.slowness, asleep))

        def kill() -> None:
            nonlocal killed, missed
            rate, step = on.failures * on.number / 3600, 0.05
            after = random.expovariate(rate)
            while not over.wait(step):
                begun = client.scheduler_info(n_workers=-1)["workers"]
                missed, after = missed + step * (on.number - len(begun)), after - step
                alive = [nanny.pid for nanny in cluster.workers.values() if nanny.worker_address in begun and nanny.pid]
                if after < 0 and alive:
                    os.kill(random.choice(alive), signal.SIGKILL)
                    killed, after = killed + 1, random.expovariate(rate)

        killer = threading.Thread(target=kill) if on.failures > 0 else None
        if killer:
            # Who is killed while it begins is replaced by another one.
            cluster.adapt(minimum=on.number, maximum=on.number, interval="300ms")
            killer.start()
        start = time.monotonic()
        try:
            simod.dask.run(client, session, Path(folder) / f"out{suffix}", units=units, retries=100)
            took = time.monotonic() - start
        finally:
            over.set()
            if killer:
                killer.join()
        left = [file.name for file in Path(folder).iterdir()]
        if left != ([] if asleep else [f"out{suffix}"]):
            sys.exit(f"beside the output is {left}")
        return Run(took, killed, missed, "" if asleep else digest_of(Path(folder) / f"out{suffix}"))


def overhead(session: Path, units: int, workers: int, threads: list[int], runs: int, check: bool) -> None:
    """Seconds of the plain command and of running clusters, in turns; how long the stages took of the median one."""
    import contextlib

    import distributed

    import simod.dask

    suffix = Path(tomllib.loads(session.read_text())["model"]["path"]).suffix
    plain: list[float] = []
    found: dict[int, list[tuple[float, dict[str, float]]]] = {number: [] for number in threads}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=session.parent)))
        clients = {}
        for number in threads:
            # Workers take it over as they begin.
            os.environ["RAYON_NUM_THREADS"] = str(number)
            cluster = distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0")
            clients[number] = distributed.Client(stack.enter_context(cluster))
            stack.enter_context(clients[number])
            clients[number].wait_for_workers(workers)
            clients[number].run(lambda: __import__("simod.dask"))
        del os.environ["RAYON_NUM_THREADS"]
        outputs = [folder / f"{name}{suffix}" for name in ("plain", "cluster")]
        for turn in range(runs):
            _, wall, _, _ = timed("run", session, "-o", outputs[0])
            plain.append(wall)
            for number, client in clients.items():
                last: dict[str, float] = {}
                start = time.monotonic()
                notes = lambda stage, _: last.update({stage: time.monotonic()})  # noqa: B023, E731
                simod.dask.run(client, session, outputs[1], units=units, progress=notes)
                ends = [start, *last.values()]
                took = {stage: end - before for stage, before, end in zip(last, ends, ends[1:])}
                found[number].append((time.monotonic() - start, took))
                if check and turn == 0 and subprocess.run(["cmp", *outputs]).returncode != 0:
                    sys.exit("other bytes than those of the plain command")
                outputs[1].unlink()
            outputs[0].unlink()
            print(f"turn {turn + 1}: {wall:.1f} s, " + ", ".join(f"{of[-1][0]:.1f} s" for of in found.values()), flush=True)
    usual = statistics.median(plain)
    print(f"plain: {usual:.1f} s, from {min(plain):.1f} to {max(plain):.1f}")
    for number, of in found.items():
        of.sort(key=lambda run: run[0])
        seconds, stages = of[len(of) // 2]
        told = ", ".join(f"{stage} {took:.1f}" for stage, took in stages.items())
        print(f"{workers} workers of {number} threads: {seconds:.1f} s, {seconds / usual - 1:+.1%} ({told})")


def digest_of(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def manner(slow: float, slowness: float, asleep: dict[str, float] | None) -> object:
    """What has the first workers take so many times as long, those that come back among them; asleep or not."""
    import distributed

    class Manner(distributed.WorkerPlugin):
        def setup(self, worker: distributed.Worker) -> None:
            import importlib

            module = importlib.import_module("simod.dask")
            done = module._unit
            times = slowness if int(worker.name) < slow else 1.0

            def unit(folder: str, number: int) -> bool:
                if asleep is not None:
                    plan = tomllib.loads((Path(folder) / "plan.toml").read_text())
                    time.sleep(times * asleep[plan["unit"][number]["stage"]])
                    return True
                start = time.monotonic()
                did = done(folder, number)
                time.sleep((times - 1) * (time.monotonic() - start))
                return did

            module._unit = unit

    return Manner()


def survived(session: Path, units: int, workers: int, kills: int) -> None:
    """Runs until so many workers were killed, each about every ten seconds."""
    os.environ["RAYON_NUM_THREADS"] = "1"
    suffix = Path(tomllib.loads(session.read_text())["model"]["path"]).suffix
    with tempfile.TemporaryDirectory(dir=session.parent) as folder:
        command("run", session, "-o", Path(folder) / f"out{suffix}")
        expected = digest_of(Path(folder) / f"out{suffix}")
    runs = killed = 0
    while killed < kills:
        run = cluster_run(session, units, Machines(workers, 1, 1e12, failures=360.0))
        if run.digest != expected:
            sys.exit(f"run {runs + 1}: other bytes than those of one machine")
        runs, killed = runs + 1, killed + run.killed
        print(f"run {runs}: {run.seconds:.1f} s, {run.killed} workers killed, {killed} in all", flush=True)
    print(f"{killed} workers killed in {runs} runs: the bytes of one machine, and nothing left beside them")


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
    one.add_argument("--runs", type=int, default=5)
    one.add_argument(
        "--vertices", type=float, default=0.0, help="workers sleep for what units take of a model of so many vertices"
    )
    one.add_argument("--slow", type=float, default=0.0, help="part of the workers that are slower")
    one.add_argument("--slowness", type=float, default=20.0)
    one.add_argument("--failures", type=float, default=0.0, help="deaths of a worker in an hour")
    one = commands.add_parser("overhead")
    one.add_argument("session", type=Path)
    one.add_argument("--units", type=int, default=4)
    one.add_argument("--workers", type=int, default=2)
    one.add_argument("--threads", default="1,2", help="of each unit: every number in turns")
    one.add_argument("--runs", type=int, default=3)
    one.add_argument("--check", action="store_true", help="compare the bytes, in the first turn")
    one = commands.add_parser("kill")
    one.add_argument("session", type=Path)
    one.add_argument("--units", type=int, default=8)
    one.add_argument("--workers", type=int, default=3)
    one.add_argument("--kills", type=int, default=100)
    given = parser.parse_args()
    if given.command == "measure":
        text = json.dumps(measured(given.session, given.units), indent=1)
        given.output.write_text(text) if given.output else print(text)
    elif given.command == "simulate":
        costs = json.loads(given.costs.read_text())
        names = [stage["stage"] for stage in costs["stages"]]
        print("| vertices | machines | " + " | ".join([*names, "all"]) + " |")
        print("|---:|---:|" + "---:|" * (len(names) + 1))
        for vertices in map(float, given.vertices.split(",")):
            for number in map(int, given.machines.split(",")):
                on = Machines(number, given.cores, given.bandwidth, given.slow, given.slowness, given.failures)
                walls = simulated(costs, vertices, min(number * given.units_each, 1000), on)
                print(f"| {vertices:.0e} | {number} | " + " | ".join(f"{s:.0f} s" for s in walls.values()) + " |")
    elif given.command == "overhead":
        threads = [int(n) for n in given.threads.split(",")]
        overhead(given.session, given.units, given.workers, threads, given.runs, given.check)
    elif given.command == "kill":
        survived(given.session, given.units, given.workers, given.kills)
    else:
        workers = [int(n) for n in given.workers.split(",")]
        how = Machines(1, 1, 1e12, given.slow, given.slowness, given.failures)
        compared(given.session, given.units, workers, given.runs, given.vertices, how)


if __name__ == "__main__":
    main()
