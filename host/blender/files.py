# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of samples: PLY as the program writes it, and as it takes it."""

import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np

KINDS = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}


class Sampled(NamedTuple):
    """A sampled model's folder."""

    folder: Path
    model: Path
    positions: np.ndarray
    """Where the samples are at rest: (N, 3), float64, model coordinates."""
    triangles: np.ndarray
    """(T, 3), int32."""
    colors: np.ndarray | None
    """(N, 3), uint8."""
    offset: np.ndarray
    """What is taken off the coordinates, as Blender's are single: of georeferenced models, zero of others."""

    @classmethod
    def load(cls, folder: Path) -> "Sampled":
        """Reads a folder."""
        description = tomllib.loads((folder / "simod.toml").read_text("utf-8"))
        positions, others, triangles = read_ply(folder / "samples.ply")
        frame = description["frame"]
        low, high = np.array(frame["min"]), np.array(frame["max"])
        is_far = np.abs([low, high]).max() > 2 * np.linalg.norm(high - low)
        offset = np.round(frame["origin"]) if is_far else np.zeros(3)
        colors = np.stack([others[c] for c in ("red", "green", "blue")], 1) if "red" in others else None
        model = (folder / str(description["model"]["path"])).resolve()
        return cls(folder, model, positions, triangles, colors, offset)

    @property
    def local(self) -> np.ndarray:
        """The samples at rest in Blender's coordinates: (N, 3), float32."""
        return (self.positions - self.offset).astype(np.float32)


def read_ply(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """Positions (N, 3), other numbers of the vertices by name, and triangles (T, 3) of a binary file."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = [line.split() for line in data[:end].decode("ascii").splitlines()]
    elements: list[tuple[str, int, list[list[str]]]] = []
    for line in lines:
        if line[0] == "element":
            elements.append((line[1], int(line[2]), []))
        elif line[0] == "property":
            elements[-1][2].append(line[1:])
    (_, count, properties), faces = elements[0], elements[1:2]
    vertices = np.frombuffer(data, np.dtype([(name, KINDS[kind]) for kind, name in properties]), count, end)
    positions = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], 1)
    triangles = np.zeros((0, 3), np.int32)
    if faces and faces[0][1]:
        face = np.dtype([("count", "u1"), ("corners", "<u4", 3)])
        records = np.frombuffer(data, face, faces[0][1], end + vertices.nbytes)
        triangles = records["corners"].astype(np.int32)
    return positions, {name: vertices[name] for _, name in properties}, triangles


def write_ply(path: Path, positions: np.ndarray) -> None:
    """Writes deformed samples, in their order, with their ids."""
    record = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("id", "<i4")])
    vertices = np.empty(len(positions), record)
    for place, axis in enumerate("xyz"):
        vertices[axis] = positions[:, place]
    vertices["id"] = np.arange(len(positions))
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(positions)}"]
    lines += [f"property double {axis}" for axis in "xyz"] + ["property int id", "end_header", ""]
    path.write_bytes("\n".join(lines).encode("ascii") + vertices.tobytes())
