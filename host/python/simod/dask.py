"""Sampling and writing models by the workers of a Dask cluster: the same bytes as on one machine.

    from dask.distributed import Client
    import simod.dask

    client = Client("scheduler:8786")
    s = simod.dask.sample(client, "scan.laz", 200_000, units=64)
    s.points[:] = my_numpy_function(s.points)
    simod.dask.apply(client, "scan.laz", s, "out.laz", units=64)
    simod.dask.run(client, "edit.toml")             # or a whole session
    simod.dask.run(client, ["a.toml", "b.toml"])    # or several ones, which share samples where they can
    simod.dask.compare(client, "compare.toml", "page")

The work is divided into units, from files to files (``simod plan``): all workers have to see the model, the output and
the folder of the plan by the same names, and to have this package in the same version. A unit that fails, or whose
worker dies, is done again, by another worker where there is one; what is done already is not.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, overload

try:
    from distributed import Client, Future, get_worker
except ImportError as _missing:  # pragma: no cover
    raise ImportError("simod.dask needs Dask: pip install 'dask[distributed]'") from _missing

from ._bar import Bar
from ._errors import ArgumentError, Error, FileError
from ._simod import Samples, _comparison_plan, _plan, _unit, load

if TYPE_CHECKING:
    from ._simod import _By, _Method, _Normals, _Place

__all__ = ["Report", "apply", "compare", "run", "sample"]

_Path = str | PathLike[str]
_Paths = list[str] | list[Path] | list[_Path]
_Progress = bool | Callable[[str, float | None], object] | None


@dataclass(frozen=True)
class Report:
    """What a cluster did."""

    output: Path
    units: int
    """Units that were done."""
    again: int
    """How often one was done again, as it had failed, or its worker had died."""
    seconds: float


def sample(
    client: Client,
    model: _Path,
    samples: int | None = None,
    *,
    error: float | None = None,
    by: _By | None = None,
    place: _Place | None = None,
    grid: int | None = None,
    units: int = 16,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
) -> Samples:
    """Samples a model, as ``simod.Model.sample`` does, by so many units.

    `folder` is where the plan goes, which all workers have to see; a hidden folder beside the model where it is not
    given. It is removed in the end. A unit is done again at most `retries` times. `resources` is what a unit takes of
    a worker's, as {"simod": 1}: each unit uses all cores, so one at a time is enough. `progress` is True for a line
    on standard error, or a function (stage, fraction).
    """
    path = Path(model).absolute()
    sampling = {"samples": samples, "error": error, "by": by, "place": place, "grid": grid}
    with _planned(path, path, sampling, folder, units, None) as plan:
        _Work(client, retries, resources, progress).do([plan], before="deform")
        return load(plan.samples)


def apply(
    client: Client,
    model: _Path,
    samples: Samples,
    out: _Path,
    *,
    normals: _Normals = "transform",
    method: _Method = "blended-jets",
    choose_offset: bool = False,
    overwrite: bool = False,
    units: int = 16,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
) -> Report:
    """Carries the deformation of the samples over to all vertices of their model, as ``simod.Model.apply`` does.

    `folder` is beside the output where it is not given; the rest is as of `sample` and ``simod.Model.apply``.
    """
    path, output = Path(model).absolute(), Path(out).absolute()
    how = {"normals": normals, "method": method, "choose_offset": choose_offset, "overwrite": overwrite}
    with _planned(path, output, {}, folder, units, output, **how) as plan:
        samples.save(plan.samples)
        samples.write(plan.folder / "deformed.ply")
        return _Work(client, retries, resources, progress).do([plan], after="deform")[0]


@overload
def run(
    client: Client,
    session: _Path,
    out: _Path | None = None,
    *,
    model: _Path | None = None,
    normals: _Normals = "transform",
    method: _Method = "blended-jets",
    choose_offset: bool = False,
    lossy: bool = False,
    overwrite: bool = False,
    units: int = 16,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
) -> Report: ...


@overload
def run(
    client: Client,
    session: _Paths,
    out: _Paths | None = None,
    *,
    model: _Path | None = None,
    normals: _Normals = "transform",
    method: _Method = "blended-jets",
    choose_offset: bool = False,
    lossy: bool = False,
    overwrite: bool = False,
    units: int = 16,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
) -> list[Report]: ...


def run(
    client: Client,
    session: _Path | _Paths,
    out: _Path | _Paths | None = None,
    *,
    units: int = 16,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
    **how: Any,
) -> Report | list[Report]:
    """Does a session, as ``simod.Session.run`` does: the rest is as of `apply`.

    Of a list of sessions, `out` is a list of as many files. Those of one model and one sampling share its samples, and
    what is done for one of them is done beside what is done for others; each is divided into as many units. An error of
    one ends all, but what was finished stays.

    Functions that ``simod.deformer`` registered have to be so on the workers, too.
    """
    several = isinstance(session, list)
    sessions = session if isinstance(session, list) else [session]
    outs = out if isinstance(out, list) else [out] * len(sessions)
    if not sessions or len(outs) != len(sessions) or (isinstance(out, list) != several and out is not None):
        raise ArgumentError("`out` does not name a file for each session", "give as many, or leave it out")
    paths = [Path(one).absolute() for one in sessions]
    with _folder(folder, paths[0]) as where:
        plans: list[_Plan] = []
        for number, (path, output) in enumerate(zip(paths, outs, strict=True)):
            own = where.with_name(f"plan-{number}") if several else where
            # Samples of several have what any of them needs.
            plan = _Plan.of(own, _plan(path, own, output, units=units, whole=several, **how))
            if any(plan.output == other.output for other in plans):
                raise ArgumentError(f"two sessions go to {plan.output}", "give each of them an output of its own")
            plans.append(plan)
        reports = _Work(client, retries, resources, progress).do(plans)
        return reports if several else reports[0]


def compare(
    client: Client,
    file: _Path,
    out: _Path,
    *,
    model: _Path | None = None,
    keep_models: bool = False,
    allow_commands: bool = False,
    folder: _Path | None = None,
    retries: int = 5,
    resources: Mapping[str, float] | None = None,
    progress: _Progress = None,
) -> dict[str, Any]:
    """Does the methods of a comparison beside each other, as ``simod.compare`` does one after the other.

    Each sampling is a unit, then each method, and the last one compares what they came to and writes the folder `out`. It
    has the figures, pictures and hashes of one machine; times are those of the workers. The deformed models of all
    methods are in `folder` meanwhile, which is beside `out` where it is not given. Programs that the file names are run by
    the workers if `allow_commands` says so. The rest is as of `sample`. Gives what is in compare.json.
    """
    path, output = Path(file).absolute(), Path(out).absolute()
    with _folder(folder, output) as where:
        content = _comparison_plan(
            path, where, output, model=model, keep_models=keep_models, allow_commands=allow_commands
        )
        plan = _Plan.of(where, content)
        _Work(client, retries, resources, progress).do([plan])
    figures: dict[str, Any] = json.loads((output / "compare.json").read_bytes())
    return figures


@dataclass(frozen=True)
class _Unit:
    folder: Path
    number: int
    stage: str


@dataclass(frozen=True)
class _Plan:
    folder: Path
    output: Path
    sampled: str
    """Plans of the same text here take the same samples."""
    units: tuple[tuple[int, str], ...]

    @classmethod
    def of(cls, folder: Path, content: str) -> _Plan:
        values: dict[str, Any] = json.loads(content)
        units = ((unit["number"], unit["stage"]) for unit in values["units"])
        return cls(folder, Path(values["output"]), values["sampled"], tuple(units))

    @property
    def samples(self) -> Path:
        return self.folder / "sampled.simod"


@contextmanager
def _folder(given: _Path | None, beside: Path) -> Iterator[Path]:
    """A new folder for a plan, which is removed in the end."""
    if given is not None:
        folder = Path(given).absolute()
        folder.mkdir(parents=True)
    else:
        name, place = re.sub(r"[*?\[]", "_", beside.name), beside.parent
        # The wildcards of a pattern are of no place.
        while re.search(r"[*?\[]", fspath(place)) and not place.exists():
            place = place.parent
        folder = Path(tempfile.mkdtemp(prefix=f".simod-{name}-", suffix=".plan", dir=place))
    try:
        # A plan appears whole: as a folder in this one, beside what it is made of.
        yield folder / "plan"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _planned(
    model: Path,
    beside: Path,
    sampling: Mapping[str, object],
    folder: _Path | None,
    units: int,
    out: Path | None,
    **how: Any,
) -> Iterator[_Plan]:
    """The plan of a session without steps."""
    with _folder(folder, beside) as where:
        session = where.with_name("session.toml")
        lines = ["[model]", f"path = {json.dumps(fspath(model))}", "[sampling]"]
        lines += [f"{key} = {json.dumps(value)}" for key, value in sampling.items() if value is not None]
        session.write_text("\n".join(lines) + "\n", encoding="utf-8")
        # A session that only samples writes nothing: there has to be a name all the same.
        output = where.with_name(f"none{model.suffix}") if out is None else out
        yield _Plan.of(where, _plan(session, where, output, units=units, whole=True, **how))


#: The stages in the order of a run; a comparison samples, and does its own.
_STAGES = (
    *("count", "merge", "cluster", "cluster-shared", "cut", "members", "faces", "complete", "sample"),
    *("deform", "apply", "finish", "write"),
    *("method", "page"),
)

#: What is done beside the units of another stage.
_BESIDE = {"face-runs": "count"}


#: Seconds between two looks at what becomes of units, for what a unit came to, and until it is said that nobody can do one.
_LOOK = 1.0
_GATHERED = 10.0
_PATIENCE = 600.0


class _Work:
    """The units of plans, stage by stage."""

    def __init__(
        self,
        client: Client,
        retries: int,
        resources: Mapping[str, float] | None,
        progress: _Progress,
    ) -> None:
        self.client, self.retries = client, retries
        self.resources = None if resources is None else dict(resources)
        self.progress = Bar() if progress is True else progress or None
        self.done: Counter[Path] = Counter()
        self.again: Counter[Path] = Counter()
        self.key = f"{os.getpid()}-{time.time_ns():x}"

    def do(self, plans: list[_Plan], *, after: str | None = None, before: str | None = None) -> list[Report]:
        """Does the stages of all plans behind one, up to before another; one of those that sample alike samples."""
        start = time.monotonic()
        sampling: dict[str, _Plan] = {}
        for plan in plans:
            sampling.setdefault(plan.sampled, plan)
        first = 0 if after is None else _STAGES.index(after) + 1
        last = len(_STAGES) if before is None else _STAGES.index(before)
        try:
            for stage in _STAGES[first:last]:
                if stage == "deform":
                    for plan in plans:
                        if plan is not sampling[plan.sampled]:
                            shutil.copytree(sampling[plan.sampled].samples, plan.samples)
                whose = list(sampling.values()) if _STAGES.index(stage) < _STAGES.index("deform") else plans
                units = [
                    _Unit(plan.folder, number, of)
                    for plan in whose
                    for number, of in plan.units
                    if _BESIDE.get(of, of) == stage
                ]
                if units:
                    self._stage(units)
        finally:
            if isinstance(self.progress, Bar):
                self.progress.close()
        seconds = time.monotonic() - start
        return [Report(plan.output, self.done[plan.folder], self.again[plan.folder], seconds) for plan in plans]

    def _submit(self, unit: _Unit, attempt: int, avoid: set[str]) -> Future[Any]:
        others = [address for address in self._workers() if address not in avoid] if avoid else []
        # The dashboard calls tasks by what is before the key's first number.
        key = (f"simod-{unit.stage}-{self.key}-{attempt}", unit.folder.name, unit.number)
        return self.client.submit(
            _do_unit,
            fspath(unit.folder),
            unit.number,
            key=key,
            pure=False,
            workers=others or None,
            allow_other_workers=bool(others),
            resources=self.resources,
        )

    def _workers(self) -> list[str]:
        return list(self.client.scheduler_info(n_workers=-1)["workers"])

    def _stage(self, units: list[_Unit]) -> None:
        stage = _Stage(self, units)
        try:
            while stage.pending:
                unit = stage.next()
                if unit is not None:
                    self.done[unit.folder] += 1
                    if self.progress is not None:
                        self.progress(unit.stage, (len(units) - len(stage.pending)) / len(units))
        finally:
            if stage.pending:
                self.client.cancel(list(stage.pending))  # type: ignore[no-untyped-call]


class _Stage:
    """The units of a stage, while they are done."""

    def __init__(self, work: _Work, units: list[_Unit]) -> None:
        self.work = work
        self.failed = dict.fromkeys(units, 0)
        self.attempts = dict.fromkeys(units, 0)
        self.avoid: dict[_Unit, set[str]] = {unit: set() for unit in units}
        self.pending: dict[Future[Any], _Unit] = {}
        self.over: SimpleQueue[Future[Any]] = SimpleQueue()
        self.looked = time.monotonic()
        self.without_worker: float | None = None
        """Since when some units have found no worker, though there are some."""
        for unit in units:
            self.begin(unit)

    def begin(self, unit: _Unit) -> None:
        future = self.work._submit(unit, self.attempts[unit], self.avoid[unit])
        self.attempts[unit] += 1
        self.pending[future] = unit
        self.wait_for(future)

    def wait_for(self, future: Future[Any]) -> None:
        future.add_done_callback(self.over.put)  # type: ignore[no-untyped-call]

    def next(self) -> _Unit | None:
        """Waits for a little while; the unit that was done meanwhile, if any. One that failed is begun again."""
        try:
            done = self._outcome(self.over.get(timeout=_LOOK))
        except Empty:
            done = None
        if time.monotonic() - self.looked >= _LOOK:
            self.look()
            self.looked = time.monotonic()
        return done

    def _outcome(self, future: Future[Any]) -> _Unit | None:
        unit = self.pending.get(future)
        if unit is None:  # it was given up meanwhile
            return None
        try:
            address, failure = future.result(timeout=_GATHERED)
        except TimeoutError:
            # The worker is gone with what it had to say: Dask has another one do the unit, or will.
            self.wait_for(future)
            return None
        except Exception as error:  # the worker is gone, or has another version
            address, failure = None, error
        if failure is not None:
            self.again(future, address, failure)
            return None
        del self.pending[future]
        return unit

    def again(self, future: Future[Any], address: str | None, failure: Exception) -> None:
        """Has a unit done again that failed, unless that is of no use."""
        unit = self.pending.pop(future)
        self.failed[unit] += 1
        if self.failed[unit] > self.work.retries or not _may_pass(failure):
            raise failure
        self.work.again[unit.folder] += 1
        if address is not None:
            self.avoid[unit].add(address)
        self.begin(unit)

    def look(self) -> None:
        """Looks whether there are units that no worker will ever take.

        Dask keeps a task for which there is no worker until there is one of those that the task would rather have: where
        these are gone for good, for ever, though others may take it.
        """
        client: Any = self.work.client
        keys = [future.key for future in self.pending]
        states = client.sync(client.scheduler.get_task_status, keys=keys) if keys else {}
        left = [(future, unit) for future, unit in self.pending.items() if states[future.key] == "no-worker"]
        workers = self.work._workers() if left else []
        if not workers:
            self.without_worker = None
            return
        for future, unit in left:
            if self.avoid[unit]:
                del self.pending[future]
                client.cancel([future])
                self.begin(unit)
        if self.work.resources is None:
            return
        now = time.monotonic()
        self.without_worker = self.without_worker or now
        if now - self.without_worker > _PATIENCE:
            unit = left[0][1]
            wanted = ", ".join(f"{amount:g} of {name}" for name, amount in self.work.resources.items())
            raise ArgumentError(
                f"nobody can do unit {unit.number} ({unit.stage}): none of {len(workers)} workers has {wanted}",
                "give workers these resources, or leave `resources` out",
            )


def _may_pass(failure: Exception) -> bool:
    """Whether a failure may have to do with the worker: what is wrong with the files is so anywhere."""
    return isinstance(failure, FileError) or not isinstance(failure, Error)


def _do_unit(folder: str, number: int) -> tuple[str, Exception | None]:
    """Does a unit: the worker's address, and what has failed, if anything."""
    address = get_worker().address
    try:
        while True:
            try:
                _unit(folder, number)
                return address, None
            except Error as error:
                # By one that was taken for dead: it ends, or has done it.
                if "is being written by another process" not in error.what:
                    raise
                time.sleep(1.0)
    except Exception as error:
        return address, error
