"""Work that is stopped: by Ctrl-C, by what a progress function raises, by the end of the interpreter."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import simod


def python(code: str, *arguments: object) -> subprocess.Popen[str]:
    # Whoever runs tests in the background has them ignore Ctrl-C.
    hear = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    command = [sys.executable, "-c", hear + code, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


APPLY = """
import sys, threading, simod
model = simod.open(sys.argv[1])
samples = model.sample(20000)
samples.points[:, 0] *= 1 + samples.points[:, 1] ** 2
def tell(stage, fraction):
    if stage == "reconstructing": print(stage, flush=True)
def write():
    model.apply(samples, sys.argv[2], progress=tell)
"""


def test_progress_is_told(bar: Path, tmp_path: Path) -> None:
    told: list[tuple[str, float | None, threading.Thread]] = []
    model = simod.open(bar)
    samples = model.sample(5000, progress=lambda s, f: told.append((s, f, threading.current_thread())))
    stages = [stage for stage, _, _ in told]
    assert "clustering" in stages and len(set(stages)) > 1
    assert all(f is None or 0 <= f <= 1 for _, f, _ in told) and told[-1][1] == 1
    assert {thread for _, _, thread in told} == {threading.current_thread()}
    model.apply(samples, tmp_path / "out.ply", progress=True)


def test_the_lock_is_free_meanwhile(bar: Path) -> None:
    turns = 0
    is_over = threading.Event()

    def count() -> None:
        nonlocal turns
        while not is_over.is_set():
            turns += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    start = time.monotonic()
    simod.open(bar).sample(5000)
    seconds = time.monotonic() - start
    is_over.set()
    thread.join()
    assert turns > 50 * seconds


def test_what_progress_raises_stops_the_work(bar: Path, tmp_path: Path) -> None:
    model = simod.open(bar)
    samples = model.sample(20_000)
    samples.points[:, 0] *= 2

    def stop(stage: str, fraction: float | None) -> None:
        raise LookupError(stage)

    for work in (lambda: model.sample(5000, progress=stop), lambda: model.apply(samples, tmp_path / "x.ply", progress=stop)):
        with pytest.raises(LookupError):
            work()
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c(bar: Path, tmp_path: Path) -> None:
    # Again and again, as the signal may come late on a busy machine.
    code = APPLY + """
import os
try:
    while True:
        write()
        os.remove(sys.argv[2])
except KeyboardInterrupt:
    print("stopped")
"""
    process = python(code, bar, tmp_path / "out.ply")
    assert process.stdout is not None
    assert process.stdout.readline() == "reconstructing\n"
    process.send_signal(signal.SIGINT)
    rest, errors = process.communicate(timeout=60)
    assert rest.endswith("stopped\n") and process.returncode == 0, errors
    assert list(tmp_path.iterdir()) == []


def test_the_interpreter_ends_while_a_model_is_written(bar: Path, tmp_path: Path) -> None:
    code = APPLY + """
import time
thread = threading.Thread(target=write, daemon=True)
thread.start()
time.sleep(float(sys.argv[3]))
"""
    for seconds in (0.0, 0.2, 0.4):
        process = python(code, bar, tmp_path / "out.ply", seconds)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert [p.name for p in tmp_path.iterdir() if p.name != "out.ply"] == []


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such processes here")
def test_a_process_that_was_forked(plane: Path) -> None:
    simod.open(plane).sample(1000)
    child = os.fork()
    if child == 0:
        try:
            samples = simod.open(plane).sample(1000)
            samples.apply("warp", angle=10)
            os._exit(0 if len(samples) > 500 else 1)
        except BaseException:
            os._exit(2)
    for _ in range(600):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            assert os.waitstatus_to_exitcode(status) == 0
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    pytest.fail("the child hangs")


def test_several_threads(plane: Path, tmp_path: Path) -> None:
    model = simod.open(plane)
    failures: list[BaseException] = []

    def work(number: int) -> None:
        try:
            samples = model.sample(1000)
            samples.points[:, 1] += number
            report = model.apply(samples, tmp_path / f"{number}.ply")
            heights = np.concatenate([c[:, 1] for c in simod.open(report.output).chunks()])
            assert heights.mean() == pytest.approx(number, abs=0.1)
        except BaseException as e:
            failures.append(e)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_importing_is_quick() -> None:
    code = "import time; start = time.process_time(); import simod; print(time.process_time() - start)"
    seconds = min(float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout) for _ in range(3))
    print(f"import simod: {seconds:.3f} s")
