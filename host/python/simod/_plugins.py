"""The plugins as functions, with help."""

import inspect
import json
import keyword
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from ._simod import Samples, _plugin_data

_KINDS: dict[str, Any] = {"float": float, "int": int, "bool": bool, "choice": str}


class PluginFunction:
    """A plugin: `plugin(samples, …)` is `samples.apply(plugin.id, …)`. `help(plugin)` tells its parameters."""

    id: str
    version: str
    summary: str
    parameters: dict[str, dict[str, Any]]
    """What is known of each parameter, by its name as a keyword: kind, unit, default, ranges and hint."""

    def __init__(self, data: dict[str, Any]) -> None:
        self.id = data["id"]
        self.version = data["version"]
        self.summary = data["summary"]
        self.parameters = {_keyword(p["id"]): p for p in data["params"]}
        self.__name__ = self.id
        self.__doc__ = _doc(data, self.parameters)
        self.__signature__ = _signature(self.parameters)

    def __call__(self, samples: Samples, /, **parameters: Any) -> None:
        samples.apply(self.id, **parameters)

    def __repr__(self) -> str:
        return f"<simod plugin {self.id!r} {self.version}>"


class Plugins(Mapping[str, PluginFunction]):
    """All deformers by id: plugins that came with the package, the user's own, and registered functions."""

    def _all(self) -> dict[str, PluginFunction]:
        return {data["id"]: PluginFunction(data) for data in json.loads(_plugin_data())}

    def __getitem__(self, id: str) -> PluginFunction:
        known = self._all()
        if id not in known:
            raise KeyError(f"there is no plugin {id!r}: there are {', '.join(known)}")
        return known[id]

    def __getattr__(self, name: str) -> PluginFunction:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name.replace("_", "-")]
        except KeyError as e:
            raise AttributeError(e.args[0]) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(id.replace("-", "_") for id in self)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __repr__(self) -> str:
        return f"<simod.plugins: {', '.join(self)}>"


def _keyword(id: str) -> str:
    """A parameter as Python can name it: `from_` is `from`."""
    name = id.replace("-", "_")
    return name + "_" if keyword.iskeyword(name) else name


def _signature(parameters: dict[str, dict[str, Any]]) -> inspect.Signature:
    only = inspect.Parameter.KEYWORD_ONLY
    return inspect.Signature(
        [
            inspect.Parameter("samples", inspect.Parameter.POSITIONAL_ONLY, annotation=Samples),
            *(
                inspect.Parameter(name, only, default=p["default"], annotation=_KINDS.get(p["kind"], Any))
                for name, p in parameters.items()
            ),
            *(inspect.Parameter(name, only, default=None) for name in ("regions", "handles", "joints", "strokes")),
        ],
        return_annotation=None,
    )


def _doc(data: dict[str, Any], parameters: dict[str, dict[str, Any]]) -> str:
    wants = {
        "fixed_regions": "fixed regions",
        "handle_regions": "handle regions",
        "joints": "joints",
        "strokes": "strokes",
        "handles": "handles, which it places itself",
    }
    used = [text for key, text in wants.items() if data[key]]
    lines = [f"{data['summary']}.", "", f"samples.apply({data['id']!r}, …), version {data['version']}."]
    if used:
        lines += ["", f"It takes {', '.join(used)}. Masks work with any plugin."]
    for name, p in parameters.items():
        lines += ["", f"{name} = {p['default']!r}", *textwrap.wrap(p["text"], 96, initial_indent="    ", subsequent_indent="    ")]
    if data["citation"]:
        lines += ["", *textwrap.wrap(data["citation"], 100)]
    return "\n".join(lines)


plugins = Plugins()
