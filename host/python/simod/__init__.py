"""SIMOD: freeform deformation of models of any size.

A model too large for memory is sampled to a small set of points, which anything may deform, and the deformation is
streamed back onto every vertex::

    import simod

    m = simod.open("scan.laz")
    s = m.sample(200_000, progress=True)
    s.points[:] = my_numpy_function(s.points)       # arrays of shape (N, 3), float64, model coordinates
    s.apply("warp", operation="twist", angle=30)    # or a plugin; help(simod.plugins["warp"])
    m.apply(s, "out.laz", progress=True)

What fails raises a ``simod.Error``, with a ``hint`` that says what to do. Ctrl-C stops whatever goes on, and leaves
nothing half done.
"""

import atexit as _atexit

from ._deformers import Deformer, deformer
from ._errors import (
    ArgumentError,
    Cancelled,
    DegenerateError,
    Error,
    FileError,
    FormatError,
    MismatchError,
    PluginError,
    SimodWarning,
)
from ._plugins import PluginFunction, Plugins, plugins
from ._records import Certificate, ExpectedError, Info, Region, Report, TransferError
from ._simod import Chunks, Model, Samples, Session, _stop_all, compare, load, open, sample

_atexit.register(_stop_all)

__version__ = "0.1.0"

__all__ = [
    "ArgumentError",
    "Cancelled",
    "Certificate",
    "Chunks",
    "DegenerateError",
    "Deformer",
    "Error",
    "ExpectedError",
    "FileError",
    "FormatError",
    "Info",
    "MismatchError",
    "Model",
    "PluginError",
    "PluginFunction",
    "Plugins",
    "Region",
    "Report",
    "Samples",
    "Session",
    "SimodWarning",
    "TransferError",
    "compare",
    "deformer",
    "load",
    "open",
    "plugins",
    "sample",
]
