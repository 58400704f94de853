"""Progress on standard error."""

import sys
import time


class Bar:
    """A line that says where work is; on a terminal alone it is written again and again."""

    def __init__(self) -> None:
        self._stage = ""
        self._start = time.monotonic()
        self._width = 0

    def __call__(self, stage: str, fraction: float | None) -> None:
        if stage != self._stage:
            self._end()
            self._stage, self._start = stage, time.monotonic()
        if sys.stderr.isatty():
            part = "" if fraction is None else f" [{'#' * round(30 * fraction):<30}] {100 * fraction:3.0f} %"
            line = f"{stage}{part} {time.monotonic() - self._start:.1f} s"
            sys.stderr.write("\r" + line.ljust(self._width))
            sys.stderr.flush()
            self._width = len(line)

    def close(self) -> None:
        """The work is over."""
        self._end()
        self._stage = ""

    def _end(self) -> None:
        if not self._stage:
            return
        if sys.stderr.isatty():
            sys.stderr.write("\n")
        else:
            sys.stderr.write(f"{self._stage}: {time.monotonic() - self._start:.1f} s\n")
        sys.stderr.flush()
        self._width = 0
