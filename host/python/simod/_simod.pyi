"""The native part of simod."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Protocol, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._records import Info, Report

__all__ = [
    "Chunks",
    "Model",
    "Samples",
    "Session",
    "_comparison_plan",
    "_plan",
    "_plugin_data",
    "_register",
    "_stop_all",
    "_unit",
    "compare",
    "load",
    "open",
    "sample",
]

_Path = str | PathLike[str]
_Progress = bool | Callable[[str, float | None], object] | None
_Normals = Literal["transform", "keep", "drop"]
_Method = Literal["blended-jets", "projected-barycentric"]
_By = Literal["error", "area", "vertices"]
_Place = Literal["automatic", "faces", "vertices"]
_Table = Mapping[str, Any]

class _HasId(Protocol):
    id: str

@final
class Chunks:
    def __iter__(self) -> Chunks: ...
    def __next__(self) -> NDArray[np.float64]: ...

@final
class Model:
    @property
    def path(self) -> Path: ...
    @property
    def info(self) -> Info: ...
    @property
    def unit(self) -> str | None: ...
    def __len__(self) -> int: ...
    def chunks(self, start: int = 0, stop: int | None = None) -> Chunks: ...
    def sample(
        self,
        samples: int | None = None,
        *,
        error: float | None = None,
        by: _By | None = None,
        place: _Place | None = None,
        grid: int | None = None,
        memory_limit: int | None = None,
        temporary: _Path | None = None,
        progress: _Progress = None,
    ) -> Samples: ...
    def apply(
        self,
        samples: Samples,
        out: _Path,
        *,
        normals: _Normals = "transform",
        method: _Method = "blended-jets",
        diagnostics: _Path | None = None,
        choose_offset: bool = False,
        lossy: bool = False,
        overwrite: bool = False,
        progress: _Progress = None,
    ) -> Report: ...

@final
class Samples:
    @property
    def rest(self) -> NDArray[np.float64]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @points.setter
    def points(self, value: ArrayLike) -> None: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.uint32]: ...
    @property
    def spacing(self) -> NDArray[np.float64]: ...
    @property
    def colors(self) -> NDArray[np.uint8] | None: ...
    @property
    def bounds(self) -> NDArray[np.float64]: ...
    @property
    def steps(self) -> list[str]: ...
    def __len__(self) -> int: ...
    def apply(
        self,
        deformer: str | _HasId,
        *,
        regions: Iterable[_Table] | None = None,
        handles: Mapping[str, _Table] | Iterable[_Table] | None = None,
        joints: Iterable[_Table] | None = None,
        strokes: Iterable[_Table] | None = None,
        params: dict[str, Any] | None = None,
        progress: _Progress = None,
        **parameters: Any,
    ) -> None: ...
    def refine(
        self,
        shapes: Sequence[_Table] | None = None,
        *,
        factor: float | None = None,
        samples: int | None = None,
        error: float | None = None,
        auto: bool = False,
        progress: _Progress = None,
    ) -> None: ...
    def undo(self) -> bool: ...
    def redo(self) -> bool: ...
    def transfer(
        self, points: ArrayLike, normals: ArrayLike | None = None, *, progress: _Progress = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]: ...
    def save(self, folder: _Path) -> None: ...
    def write(self, path: _Path) -> None: ...
    def read(self, path: _Path) -> None: ...

@final
class Session:
    def __new__(cls, path: _Path) -> Session: ...
    @property
    def path(self) -> Path: ...
    @property
    def model(self) -> Path | None: ...
    @property
    def output(self) -> Path | None: ...
    @property
    def steps(self) -> list[str]: ...
    def run(
        self,
        out: _Path | None = None,
        *,
        model: _Path | None = None,
        normals: _Normals = "transform",
        method: _Method = "blended-jets",
        measure: bool = False,
        exact: bool = False,
        tolerance: float | str | None = None,
        diagnostics: _Path | None = None,
        choose_offset: bool = False,
        lossy: bool = False,
        overwrite: bool = False,
        progress: _Progress = None,
    ) -> Report: ...

def open(path: _Path, *, columns: str | None = None) -> Model: ...
def load(folder: _Path) -> Samples: ...
def sample(
    points: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    triangles: ArrayLike | None = None,
    samples: int | None = None,
    error: float | None = None,
    by: _By | None = None,
    place: _Place | None = None,
    grid: int | None = None,
    progress: _Progress = None,
) -> Samples: ...
def compare(
    file: _Path,
    output: _Path,
    *,
    model: _Path | None = None,
    keep_models: bool = False,
    allow_commands: bool = False,
    progress: _Progress = None,
) -> dict[str, Any]: ...
def _plugin_data() -> str: ...
def _register(function: Callable[..., Any], description: str) -> None: ...
def _stop_all() -> None: ...

def _plan(
    session: _Path,
    folder: _Path,
    out: _Path | None = None,
    *,
    units: int,
    model: _Path | None = None,
    normals: _Normals = "transform",
    method: _Method = "blended-jets",
    choose_offset: bool = False,
    lossy: bool = False,
    overwrite: bool = False,
    whole: bool = False,
) -> str: ...
def _comparison_plan(
    file: _Path,
    folder: _Path,
    out: _Path,
    *,
    model: _Path | None = None,
    keep_models: bool = False,
    allow_commands: bool = False,
) -> str: ...
def _unit(folder: _Path, number: int) -> bool: ...
