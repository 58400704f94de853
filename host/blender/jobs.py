# SPDX-License-Identifier: GPL-3.0-or-later
"""The program at work, as a process beside Blender."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def program(preferred: str) -> str:
    """The program: the one that the preferences name, or the one on the path."""
    found = preferred or os.environ.get("SIMOD_PROGRAM") or shutil.which("simod")
    if not found or not Path(found).exists():
        raise FileNotFoundError("the program simod is not there: say where it is in the add-on's preferences")
    return found


class Job:
    """Commands, one after the other, of which the first that fails is the last."""

    def __init__(self, what: str, commands: list[list[str]], outputs: list[Path], expected: int) -> None:
        self.what = what
        self.error = ""
        self.hint = ""
        self.report: dict[str, Any] = {}
        self.folder = Path(tempfile.mkdtemp(prefix="simod-"))
        self.on_done: Callable[[Job], None] | None = None
        self.commands = commands
        self._outputs = outputs
        self._expected = max(expected, 1)
        self.process: subprocess.Popen[str] | None = None
        self._cancelled = threading.Event()
        self._started = time.monotonic()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> "Job":
        """Begins, in the background."""
        self._thread.start()
        return self

    @property
    def is_over(self) -> bool:
        """Whether there is nothing more to wait for."""
        return not self._thread.is_alive()

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.monotonic() - self._started

    def progress(self) -> float:
        """How much is written, 0 to 1: what there is of the hidden files beside the outputs, and of these."""
        written = 0
        for output in self._outputs:
            try:
                hidden = [p for p in output.parent.iterdir() if p.name.startswith(".simod-") and p.suffix == ".part"]
                written += sum(p.stat().st_size for p in hidden)
            except OSError:
                pass
        return min(1.0, written / self._expected)

    def wait(self) -> None:
        """Until it is over."""
        self._thread.join()

    def cancel(self) -> None:
        """Asks it to stop; what it was writing is removed."""
        self._cancelled.set()
        process = self.process
        if process and process.poll() is None:
            process.send_signal(signal.SIGINT if os.name != "nt" else signal.SIGTERM)

    def close(self) -> None:
        """Removes what it worked on."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _run(self) -> None:
        for command in self.commands:
            if self._cancelled.is_set():
                self.error = "cancelled"
                return
            try:
                self.process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
                )
            except OSError as e:
                self.error = f"{command[0]}: {e}"
                return
            if self._cancelled.is_set():
                self.cancel()
            out, errors = self.process.communicate()
            if self.process.returncode != 0:
                told = dict(line.split(": ", 1) for line in errors.splitlines() if ": " in line)
                self.error = "cancelled" if self._cancelled.is_set() else told.get("error", "the program failed")
                self.hint = told.get("hint", "")
                return
            if out.strip():
                self.report = json.loads(out)
