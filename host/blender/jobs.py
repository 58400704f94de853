# SPDX-License-Identifier: GPL-3.0-or-later
"""The program at work, as a process beside Blender."""

import json
import os
import re
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

    def __init__(self, what: str, commands: list[list[str]]) -> None:
        self.what = what
        self.error = ""
        self.hint = ""
        self.stage = ""
        self.fraction = 0.0
        self.report: dict[str, Any] = {}
        self.folder = Path(tempfile.mkdtemp(prefix="simod-"))
        self.on_done: Callable[[Job], None] | None = None
        self.commands = commands
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

    def progress(self) -> str:
        """What it does now, as a line."""
        return f"{self.stage or self.what}, {self.seconds:.0f} s"

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
            # A file, as nobody reads while it is written.
            with tempfile.TemporaryFile("w+", encoding="utf-8") as out:
                try:
                    self.process = subprocess.Popen(
                        [command[0], "--progress", "lines", *command[1:]],
                        stdin=subprocess.DEVNULL,
                        stdout=out,
                        stderr=subprocess.PIPE,
                        encoding="utf-8",
                        errors="replace",
                    )
                except OSError as e:
                    self.error = f"{command[0]}: {e}"
                    return
                if self._cancelled.is_set():
                    self.cancel()
                told = self._listen(self.process)
                if self.process.wait() != 0:
                    self.error = "cancelled" if self._cancelled.is_set() else told.get("error", "the program failed")
                    self.hint = told.get("hint", "")
                    return
                out.seek(0)
                printed = out.read()
            if printed.strip():
                self.report = json.loads(printed)

    def _listen(self, process: subprocess.Popen[str]) -> dict[str, str]:
        """What the program says until it ends, by its kind; how far it is goes to `stage` and `fraction`."""
        told = {}
        for line in process.stderr or []:
            kind, _, text = line.rstrip().partition(": ")
            if kind != "progress":
                told[kind] = text
                continue
            stage, part = re.fullmatch(r"(.*?)(?: (\d+)%.*)?", text).groups()
            self.stage, self.fraction = stage, int(part or 0) / 100
        return told
