"""What is told: records of plain values."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Info:
    """What is known of a model before its vertices are read."""

    format: str
    """The file format for people, as "LAS 1.4, point format 7, LAZ"."""
    vertices: int
    faces: int
    has_normals: bool
    double_precision: bool
    """Whether positions are stored as doubles, or as integers that need them."""
    attributes: tuple[str, ...]
    """Numbers that each vertex has besides, as "red"."""
    bytes: int
    crs: str | None
    """What the file says of its coordinate reference system, as "EPSG:25832"."""
    scale: tuple[float, ...] | None
    """Positions are integers times this, plus the offset, in the model's unit; None where they are no integers."""
    offset: tuple[float, ...] | None
    details: tuple[str, ...]
    """What else the file says of itself, for people."""


@dataclass(frozen=True)
class ExpectedError:
    """How far vertices are expected to be from where the exact map takes them, as fractions of the diagonal."""

    rms: float
    p999: float
    """What 999 of 1000 vertices stay below."""
    worst: float
    of_vertices: bool
    """Whether it is told of each vertex, rather than by the samples."""
    beyond: dict[str, Any] | None = None
    """Where more is expected than one will accept, and how many samples would mend it."""


@dataclass(frozen=True)
class TransferError:
    """How far vertices are from where the exact map takes them, as fractions of the diagonal."""

    vertices: int
    rms: float
    p999: float
    max: float
    jump: float
    """The largest difference of the errors of neighbours in the file's order."""


@dataclass(frozen=True)
class Certificate:
    """The proof that a tolerance is met. Errors are fractions of the diagonal."""

    tolerance: float
    expected: float
    """The largest error that is expected around a sample."""
    vertices: ExpectedError
    """Expected errors of the vertices, or the true ones where all plugins know their map."""
    added_samples: int
    rounds: int
    sampled_anew: int | None
    """Number of first samples with which the model was sampled anew, if fewer held the search up."""
    true_error: TransferError | None
    """Of vertices chosen at random, where all plugins know their map; its jump is 0."""


@dataclass(frozen=True)
class Report:
    """What was written."""

    output: Path
    vertices: int
    non_finite: int
    """Vertices without a finite position, which were left as they are."""
    samples: int
    seconds: float
    folded_samples: int
    """Samples at which the deformation folds the surface."""
    diagonal: float
    """Of the model's bounding box at rest, in the model's unit."""
    expected_error: ExpectedError | None
    """None where it is not known, as of another method than blended-jets."""
    transfer_error: TransferError | None
    """Where it was measured."""
    certificate: Certificate | None = None
    """Where a tolerance was given."""


@dataclass(frozen=True)
class Region:
    """A part of the samples, as functions get it that have a parameter `regions`."""

    role: str
    """ "fixed" or "handle"."""
    weights: NDArray[np.float64] = field(repr=False)
    """Of shape (N,), 0 outside to 1 inside."""
    transform: NDArray[np.float64] = field(repr=False)
    """How a handle moves: shape (3, 4), the rows of [M | t], model coordinates."""


def record(name: str, content: str) -> Info | Report:
    """A record of values in JSON."""
    values: dict[str, Any] = json.loads(content)
    if name == "Info":
        lists = {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
        return Info(**(values | lists))
    expected, transfer = values.pop("expected_error"), values.pop("transfer_error")
    certificate = values.pop("certificate", None)
    if certificate is not None:
        true_error = certificate["true_error"]
        vertices = ExpectedError(**certificate["vertices"])
        true_error = None if true_error is None else TransferError(**true_error)
        certificate = Certificate(**(certificate | {"vertices": vertices, "true_error": true_error}))
    return Report(
        **{**values, "output": Path(values["output"])},
        expected_error=None if expected is None else ExpectedError(**expected),
        transfer_error=None if transfer is None else TransferError(**transfer),
        certificate=certificate,
    )
