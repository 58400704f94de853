"""Units on the workers of a cluster: the bytes of one machine, whatever becomes of the workers."""

import importlib
import os
import random
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
import numpy as np
import pytest

import simod
import simod.dask
from conftest import run as command

# Warnings of Dask about itself, and about workers that are killed.
pytestmark = pytest.mark.filterwarnings("default")

untyped: Any = distributed

SESSION = """
[model]
path = "{model}"
[sampling]
samples = 3000
[[step]]
deform = "warp"
params = {{ operation = "twist", axis = [0, 1, 0], angle = 60 }}
"""


@pytest.fixture()
def client() -> Iterator[distributed.Client]:
    """Of workers that are processes of their own, and come back when they are killed."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 20}),
        untyped.LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=":0") as cluster,
        untyped.Client(cluster) as client,
    ):
        client.wait_for_workers(3)
        yield client


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An amphora of 400 000 points without faces."""
    path = tmp_path_factory.mktemp("clouds") / "cloud.ply"
    command("generate", "--vertices", 400_000, "--no-faces", "-o", path)
    return path


def test_samples_and_models_have_the_bytes_of_one_machine(
    client: distributed.Client, cloud: Path, tmp_path: Path
) -> None:
    model = simod.open(cloud)
    expected = model.sample(3000)
    seen: list[tuple[str, float | None]] = []
    samples = simod.dask.sample(
        client, cloud, 3000, units=7, progress=lambda stage, part: seen.append((stage, part))
    )
    assert np.array_equal(samples.rest, expected.rest) and np.array_equal(samples.normals, expected.normals)
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["count", "merge", "cluster", "cluster-shared", "cut"]
    assert [part for stage, part in seen if stage == "count"] == [n / 7 for n in range(1, 8)]

    for array in (samples, expected):
        array.points[:, 0] += 0.1 * array.points[:, 1] ** 2
    model.apply(expected, tmp_path / "expected.ply")
    report = simod.dask.apply(client, cloud, samples, tmp_path / "out.ply", units=5)
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "expected.ply").read_bytes()
    assert report.units == 6 and report.again == 0 and report.output == tmp_path / "out.ply"

    # These samples are refined as others are.
    for array in (samples, expected):
        array.refine([{"sphere": {"center": [0.0, 0.5, 0.3], "radius": 0.4}}], factor=3)
    assert len(samples) == len(expected) > 3000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["expected.ply", "out.ply"]
    assert [path.name for path in cloud.parent.iterdir()] == [cloud.name]


def test_the_dashboard_shows_stages_by_name(
    client: distributed.Client, cloud: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: set[str] = set()
    submit: Any = client.submit

    def noting(*arguments: object, **keywords: object) -> object:
        seen.add(untyped.utils.key_split(keywords["key"]))
        return submit(*arguments, **keywords)

    monkeypatch.setattr(client, "submit", noting)
    simod.dask.sample(client, cloud, 500, units=2)
    assert seen == {f"simod-{stage}" for stage in ("count", "merge", "cluster", "cluster-shared", "cut")}


def edit(cloud: Path, folder: Path) -> tuple[Path, bytes]:
    """A session, and what it comes to."""
    session = folder / "edit.toml"
    session.write_text(SESSION.format(model=cloud.as_posix()))
    simod.Session(session).run(folder / "expected.ply")
    return session, (folder / "expected.ply").read_bytes()


def test_versions_share_their_samples(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "mesh.ply"
    command("generate", "--vertices", 250_000, "-o", mesh)
    texts = {
        "a": SESSION.format(model=cloud.as_posix()),
        "b": SESSION.format(model=cloud.as_posix()).replace("60", "-20")
        + "[[step]]\nrefine = { shapes = [{ sphere = { center = [0, 0.5, 0.3], radius = 0.4 } }], factor = 3 }\n",
        "c": SESSION.format(model=mesh.as_posix()),
        "d": SESSION.format(model=mesh.as_posix()).replace("60", "90"),
    }
    sessions = [tmp_path / f"{name}.toml" for name in texts]
    for session, text in zip(sessions, texts.values(), strict=True):
        session.write_text(text)
    seen: list[tuple[str, float | None]] = []
    outs = [tmp_path / f"{name}.ply" for name in texts]
    reports = simod.dask.run(
        client, sessions, outs, units=4, progress=lambda stage, part: seen.append((stage, part))
    )
    assert [report.output for report in reports] == outs
    for session, out in zip(sessions, outs, strict=True):
        simod.Session(session).run(tmp_path / "expected.ply", overwrite=True)
        assert out.read_bytes() == (tmp_path / "expected.ply").read_bytes(), out.name
    # Two have the samples of others: they are deformed, applied by four units, and finished. Of the mesh, vertices and
    # faces are gone over after the cut.
    cut = 4 + 1 + 4 + 4 + 1
    assert [report.units for report in reports] == [cut + 6, 6, cut + 4 + 4 + 1 + 6, 6]
    parts = {stage: [part for of, part in seen if of == stage] for stage in ("count", "apply")}
    assert parts["count"] == [n / 8 for n in range(1, 9)] and parts["apply"] == [n / 16 for n in range(1, 17)]
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]
    with pytest.raises(simod.ArgumentError, match="each session"):
        simod.dask.run(client, sessions, outs[:2])
    with pytest.raises(simod.ArgumentError, match="two sessions go to"):
        simod.dask.run(client, sessions[:2], [outs[0], outs[0]])


def test_tiles_are_written_by_units(client: distributed.Client, tmp_path: Path) -> None:
    (tmp_path / "tiles").mkdir()
    for number, vertices in enumerate((30_000, 60_000, 45_000)):
        command("generate", "--vertices", vertices, "--no-faces", "-o", tmp_path / "tiles" / f"t-{number}.ply")
    pattern = tmp_path / "tiles" / "t-*.ply"

    def tiles(folder: str) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}

    session = tmp_path / "edit.toml"
    session.write_text(SESSION.format(model=pattern.as_posix()))
    simod.Session(session).run(tmp_path / "expected")
    for turn in range(2):  # over the former folder, too
        report = simod.dask.run(client, session, tmp_path / "out", units=3)
        assert tiles("out") == tiles("expected"), turn
    assert report.units == 3 + 1 + 3 + 3 + 1 + 1 + 3 + 1

    model = simod.open(pattern)
    expected, samples = model.sample(1000), simod.dask.sample(client, pattern, 1000, units=3)
    assert np.array_equal(samples.rest, expected.rest)
    for array in (samples, expected):
        array.points[:, 0] += 0.1 * array.points[:, 1] ** 2
    model.apply(expected, tmp_path / "moved")
    simod.dask.apply(client, pattern, samples, tmp_path / "by-units", units=2)
    assert tiles("by-units") == tiles("moved")
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


COMPARISON = """
[model]
path = "{model}"
[sampling]
samples = 3000
[camera]
size = [120, 160]
[[method]]
name = "twisted"
deform = "warp"
params = {{ operation = "twist", axis = [0, 1, 0], angle = 60 }}
[[method]]
name = "bent, coarse"
deform = "warp"
params = {{ operation = "twist", axis = [0, 1, 0], angle = -20 }}
sampling = {{ samples = 500 }}
[[method]]
name = "not there"
session = "{none}"
[[method]]
name = "left alone"
command = "cp {{samples}} {{output}}"
"""


def comparison(cloud: Path, folder: Path) -> tuple[Path, dict[str, Any]]:
    """A comparison, and what it comes to in the folder `expected`."""
    file = folder / "compare.toml"
    file.write_text(COMPARISON.format(model=cloud.as_posix(), none=(folder / "none.toml").as_posix()))
    return file, simod.compare(file, folder / "expected", keep_models=True, allow_commands=True)


def steady(record: dict[str, Any]) -> dict[str, Any]:
    """What two runs of a comparison have in common."""
    for method in record["methods"]:
        for key in ("seconds", "peak_memory_bytes"):
            (method["figures"] or {}).pop(key, None)
    return record


def is_same(folder: Path) -> None:
    """Pictures and models are those of one machine, and there are no other files."""
    names = sorted(path.name for path in (folder / "expected").iterdir())
    assert sorted(path.name for path in (folder / "out").iterdir()) == names
    assert len([name for name in names if name.endswith((".png", ".ply"))]) == 4 + 2 + 3
    for name in names:
        if name.endswith((".png", ".ply")):
            assert (folder / "out" / name).read_bytes() == (folder / "expected" / name).read_bytes(), name
    assert sorted(path.name for path in folder.iterdir()) == ["compare.toml", "expected", "out"]


@pytest.mark.filterwarnings("ignore:not there failed")
def test_methods_are_compared_by_workers(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    file, expected = comparison(cloud, tmp_path)
    seen: list[tuple[str, float | None]] = []
    for _ in range(2):  # over the former folder, too
        seen.clear()
        record = simod.dask.compare(
            client, file, tmp_path / "out", keep_models=True, allow_commands=True,
            progress=lambda stage, part: seen.append((stage, part)),
        )  # fmt: skip
        assert steady(record) == steady(expected)
        is_same(tmp_path)
    assert seen == [("sample", 0.5), ("sample", 1), *(("method", n / 4) for n in range(1, 5)), ("page", 1)]
    with pytest.raises(simod.ArgumentError, match="runs a program"):
        simod.dask.compare(client, file, tmp_path / "out")
    is_same(tmp_path)


@pytest.mark.filterwarnings("ignore:not there failed")
def test_a_comparison_passes_over_a_full_disk(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    file, expected = comparison(cloud, tmp_path)
    limited(client, next(iter(client.scheduler_info()["workers"])))
    record = simod.dask.compare(client, file, tmp_path / "out", keep_models=True, allow_commands=True)
    assert steady(record) == steady(expected)
    is_same(tmp_path)


@pytest.mark.filterwarnings("ignore:not there failed")
def test_a_comparison_outlives_its_workers(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    file, expected = comparison(cloud, tmp_path)
    full = next(iter(client.scheduler_info()["workers"]))
    limited(client, full)
    over = threading.Event()
    killed = 0

    def kill() -> None:
        nonlocal killed
        chance = random.Random(3)
        while not over.wait(chance.uniform(0.2, 0.5)) and killed < 3:
            alive = processes(client)
            if alive:
                os.kill(chance.choice(alive), signal.SIGKILL)
                killed += 1

    cluster: Any = client.cluster
    cluster.adapt(minimum=3, maximum=3, interval="300ms")
    other = threading.Thread(target=kill)
    other.start()
    try:
        record = simod.dask.compare(
            client, file, tmp_path / "out", keep_models=True, allow_commands=True, retries=50
        )
    finally:
        over.set()
        other.join()
    assert killed > 0
    assert steady(record) == steady(expected)
    is_same(tmp_path)


def test_units_find_workers_though_those_they_would_rather_have_are_gone(
    client: distributed.Client, cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, expected = comparison(cloud, tmp_path)
    for worker in list(client.scheduler_info(n_workers=-1)["workers"])[:2]:
        limited(client, worker)
    submit: Any = client.submit
    killed: list[int] = []

    def killing(*arguments: object, **keywords: object) -> object:
        """All are killed, and gone, as a unit is to be done by others than the one that failed."""
        if keywords["workers"] and not killed:
            killed.extend(processes(client))
            for pid in killed:
                os.kill(pid, signal.SIGKILL)
            while client.scheduler_info(n_workers=-1)["workers"]:
                time.sleep(0.005)
        return submit(*arguments, **keywords)

    monkeypatch.setattr(client, "submit", killing)
    record = simod.dask.compare(
        client, file, tmp_path / "out", keep_models=True, allow_commands=True, retries=50
    )
    assert killed
    assert steady(record) == steady(expected)
    is_same(tmp_path)


def test_a_unit_that_nobody_can_do_is_told(
    client: distributed.Client, cloud: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.import_module("simod.dask"), "_PATIENCE", 1.0)
    with pytest.raises(simod.ArgumentError, match=r"unit 0 \(count\): none of 3 workers has 2 of simod") as told:
        simod.dask.sample(client, cloud, 500, units=2, resources={"simod": 2})
    assert "leave `resources` out" in str(told.value)
    assert [path.name for path in cloud.parent.iterdir()] == [cloud.name]


def run_with(
    client: distributed.Client, cloud: Path, folder: Path, meanwhile: Callable[[threading.Event], None], retries: int = 5
) -> simod.dask.Report:
    """Runs the session while something else goes on; the bytes have to be those of one machine."""
    session, expected = edit(cloud, folder)
    over = threading.Event()
    other = threading.Thread(target=meanwhile, args=(over,))
    other.start()
    try:
        report = simod.dask.run(client, session, folder / "out.ply", units=8, retries=retries)
    finally:
        over.set()
        other.join()
    assert (folder / "out.ply").read_bytes() == expected
    left = sorted(path.name for path in folder.iterdir())
    assert left == ["edit.toml", "expected.ply", "out.ply"], left
    return report


def limited(client: distributed.Client, worker: str) -> None:
    """A worker that can write no longer files than of 500 bytes, as if its disk were full."""
    client.run(
        lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (500, resource.getrlimit(resource.RLIMIT_FSIZE)[1])),
        workers=[worker],
    )


def processes(client: distributed.Client) -> list[int]:
    """The processes of workers that have begun: who is killed before that does not come back."""
    begun = client.scheduler_info(n_workers=-1)["workers"]
    cluster: Any = client.cluster
    nannies = [nanny for nanny in cluster.workers.values() if nanny.worker_address in begun]
    return [nanny.pid for nanny in nannies if nanny.pid]


def test_killed_workers_are_no_matter(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    killed = 0
    chance = random.Random(7)
    # A worker that is killed as it begins does not come back by itself.
    cluster: Any = client.cluster
    cluster.adapt(minimum=3, maximum=3, interval="300ms")

    def kill(over: threading.Event) -> None:
        nonlocal killed
        # No more than come back meanwhile.
        for _ in range(5):
            if over.wait(chance.uniform(0.1, 0.6)):
                break
            alive = processes(client)
            if alive:
                os.kill(chance.choice(alive), signal.SIGKILL)
                killed += 1

    # As often as it takes: a quick machine is done before it is hit.
    turn = 0
    while killed < 3 and turn < 20:
        folder = tmp_path / str(turn)
        folder.mkdir()
        run_with(client, cloud, folder, kill, retries=50)
        turn += 1
    assert killed >= 3


def test_a_slow_worker_is_waited_for(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    def slow() -> None:
        module: Any = importlib.import_module("simod.dask")
        quick = module._unit

        def unit(folder: str, number: int) -> bool:
            start = time.monotonic()
            done: bool = quick(folder, number)
            time.sleep(19 * (time.monotonic() - start))
            return done

        module._unit = unit

    client.run(slow, workers=[next(iter(client.scheduler_info()["workers"]))])
    run_with(client, cloud, tmp_path, lambda over: None)


def test_a_worker_with_a_full_disk_is_passed_over(
    client: distributed.Client, cloud: Path, tmp_path: Path
) -> None:
    full = next(iter(client.scheduler_info()["workers"]))
    limited(client, full)
    report = run_with(client, cloud, tmp_path, lambda over: None)
    assert report.again > 0


def test_what_is_wrong_is_told_at_once(client: distributed.Client, cloud: Path, tmp_path: Path) -> None:
    with pytest.raises(simod.FileError):
        simod.dask.sample(client, tmp_path / "none.ply", 100)
    broken = tmp_path / "broken.ply"
    broken.write_bytes(cloud.read_bytes()[:-1000])
    with pytest.raises(simod.Error, match="broken.ply"):
        simod.dask.sample(client, broken, 100)
    samples = simod.open(cloud).sample(500)
    with pytest.raises(simod.ArgumentError, match="cloud.ply"):
        simod.dask.apply(client, cloud, samples, cloud)
    assert [path.name for path in tmp_path.iterdir()] == ["broken.ply"]
