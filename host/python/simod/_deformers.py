"""Python functions as deformers."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, ParamSpec, get_args, get_origin, overload

from ._simod import _register

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    _Points = NDArray[np.float64]

_P = ParamSpec("_P")


class Deformer(Generic[_P]):
    """A function that was registered: it can be called as before, and be given to `Samples.apply`."""

    id: str
    """What sessions call it."""

    def __init__(self, function: Callable[_P, _Points], id: str) -> None:
        self.id = id
        self._function = function
        self.__doc__ = function.__doc__
        self.__name__ = getattr(function, "__name__", id)
        self.__wrapped__ = function

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _Points:
        return self._function(*args, **kwargs)

    def __repr__(self) -> str:
        return f"<simod.Deformer {self.id!r}>"


@overload
def deformer(function: Callable[_P, _Points], /) -> Deformer[_P]: ...


@overload
def deformer(
    function: None = None, /, *, id: str | None = None, everywhere: bool = False
) -> Callable[[Callable[_P, _Points]], Deformer[_P]]: ...


def deformer(
    function: Callable[_P, _Points] | None = None, /, *, id: str | None = None, everywhere: bool = False
) -> Deformer[_P] | Callable[[Callable[_P, _Points]], Deformer[_P]]:
    """Registers a function as a deformer, in the place of another one or of a plugin of that id::

        @simod.deformer
        def ripple(points, *, height: float = 0.1, axis: Literal["x", "y"] = "x"):
            points[:, 2] += height * np.sin(points[:, "xy".index(axis)])
            return points

        s.apply(ripple, height=0.2)                   # or s.apply("ripple", height=0.2), or a step of a session

    It gets points of shape (N, 3), float64, model coordinates, which it may change, and returns as many. Its other
    parameters need defaults, which say what they are: float, int, bool, a direction (three numbers), pathlib.Path or
    None (a file), or a text annotated as a Literal. A parameter `normals` gets unit normals of shape (N, 3), and
    `regions` a list of `simod.Region`.

    `id` is what sessions call it; its name with `-` for `_` unless given. With `everywhere`, the function is a map of
    space, which may be asked for any number of any points: then `Session.run` can measure its transfer. It is called
    by another thread than the one that calls `apply`.
    """

    def register(function: Callable[_P, _Points]) -> Deformer[_P]:
        name = id or getattr(function, "__name__", "").replace("_", "-")
        _register(function, json.dumps(_describe(function, name, everywhere)))
        return Deformer(function, name)

    return register if function is None else register(function)


def _describe(function: Callable[..., Any], id: str, everywhere: bool) -> dict[str, Any]:
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", id):
        raise TypeError(f"a deformer cannot be called {id!r}: give an id of small letters, as id=\"my-deformer\"")
    summary = (inspect.getdoc(function) or "").split("\n\n")[0].replace("\n", " ")
    try:
        signature = inspect.signature(function, eval_str=True)
    except NameError:
        # Annotations that are texts may speak of what is not there yet.
        signature = inspect.signature(function)
    parameters = list(signature.parameters.values())
    if not parameters or parameters[0].kind not in (
        inspect.Parameter.POSITIONAL_ONLY,
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
    ):
        raise TypeError(f"{id}: the first parameter has to be the points")
    wanted = {p.name for p in parameters[1:]}
    known = [p for p in parameters[1:] if p.name not in ("normals", "regions")]
    if everywhere and wanted & {"normals", "regions"}:
        raise TypeError(f"{id}: a map of space knows no normals and no regions of samples")
    return {
        "id": id,
        "name": id.replace("-", " ").capitalize(),
        "summary": summary[:200],
        "everywhere": everywhere,
        "normals": "normals" in wanted,
        "regions": "regions" in wanted,
        "params": [_parameter(id, p) for p in known],
    }


def _parameter(id: str, of: inspect.Parameter) -> dict[str, Any]:
    default = of.default
    found: dict[str, Any] = {"name": of.name, "id": of.name.replace("_", "-")}
    if of.kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL):
        raise TypeError(f"{id}: parameters have to be named one by one")
    if default is inspect.Parameter.empty:
        raise TypeError(f"{id}: the parameter {of.name} needs a default")
    choices = get_args(of.annotation) if get_origin(of.annotation) is Literal else ()
    if choices and default in choices and all(isinstance(c, str) for c in choices):
        return {**found, "kind": "choice", "default": [list(choices), [default]]}
    if isinstance(default, bool):
        return {**found, "kind": "bool", "default": default}
    if isinstance(default, int) and of.annotation not in (float, "float"):
        return {**found, "kind": "int", "default": default}
    if isinstance(default, (int, float)):
        return {**found, "kind": "float", "default": float(default)}
    if default is None and (of.annotation is Path or Path in get_args(of.annotation)):
        return {**found, "kind": "file", "default": None}
    if isinstance(default, (tuple, list)) and len(default) == 3:
        return {**found, "kind": "direction", "default": [float(x) for x in default]}
    raise TypeError(
        f"{id}: the parameter {of.name} is no number, bool, direction, file (Path | None = None), or text annotated as"
        " a Literal"
    )
