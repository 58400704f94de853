"""What is raised: one class for each sort of failure."""


_KEYWORDS = {
    "--offset auto": "choose_offset=True",
    "--force": "overwrite=True",
    "--lossy": "lossy=True",
    "--tolerance": "tolerance",
    "--exact": "exact",
    "--measure": "measure",
    "--method": "method",
    "--memory-limit": "memory_limit",
    "-o FILE": "an output",
}
"""What the command's options are called here, as hints speak of them."""


class Error(Exception):
    """A failure: what is wrong and where, and what to do about it."""

    what: str
    """What is wrong, and where: one line."""
    hint: str
    """What to do about it: one line."""

    def __init__(self, what: str, hint: str = "") -> None:
        super().__init__(what, hint)
        for option, keyword in _KEYWORDS.items():
            hint = hint.replace(option, keyword)
        self.what = what
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.what}\n  hint: {self.hint}" if self.hint else self.what


class FileError(Error, OSError):
    """The operating system refused to read or write."""

    def __init__(self, what: str, hint: str = "") -> None:
        Error.__init__(self, what, hint)

    __str__ = Error.__str__


class FormatError(Error, ValueError):
    """A file's content is not what its format, or its own header, says."""


class DegenerateError(Error, ValueError):
    """The content is well-formed, but there is nothing that can be worked on: no vertices, or NaN."""


class MismatchError(Error, ValueError):
    """Things that belong together do not fit: a model that changed since it was sampled."""


class ArgumentError(Error, ValueError):
    """A value is out of its range, unknown or of another type."""


class PluginError(Error, RuntimeError):
    """A plugin is missing, cannot be loaded, or failed. What a Python function raised is the cause."""


class Cancelled(Error):
    """The work was stopped as the interpreter ends."""


class SimodWarning(UserWarning):
    """Something that should be known, though the work was done."""
