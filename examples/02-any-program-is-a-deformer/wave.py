#!/usr/bin/env python3
"""Sends a wave through the samples of a model: wave.py SAMPLES.ply DEFORMED.ply

The model sways along x, two waves over its height (y), by up to 5 % of its height.
"""

import math
import struct
import sys

# The names of PLY's types, old and new, as `struct` calls them.
CODES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip


def read_header(ply):
    """Where the vertices begin, how many there are, and the names and types of their properties."""
    header, end, _ = ply.partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii", "replace").splitlines()]
    if not end or lines[0] != ["ply"] or ["format", "binary_little_endian", "1.0"] not in lines:
        sys.exit("error: not a binary little endian PLY file")
    # The vertices come first in samples.ply; elements after them are copied as they are.
    first, last, *_ = [i for i, line in enumerate(lines) if line[0] == "element"] + [len(lines)]
    _, name, count = lines[first]
    properties = [line[1:] for line in lines[first:last] if line[0] == "property"]
    if name != "vertex" or any(kind == "list" for kind, *_ in properties):
        sys.exit("error: the first element is not of plain vertices")
    return len(header + end), int(count), {name: CODES[kind] for kind, name in properties}


def main(source, target):
    with open(source, "rb") as file:
        ply = bytearray(file.read())
    begin, count, properties = read_header(ply)
    layout = struct.Struct("<" + "".join(properties.values()))
    x, y = (list(properties).index(axis) for axis in "xy")
    vertices = [list(v) for v in layout.iter_unpack(ply[begin : begin + count * layout.size])]

    low = min(v[y] for v in vertices)
    height = max(v[y] for v in vertices) - low
    for v in vertices:
        v[x] += 0.05 * height * math.sin(4 * math.pi * (v[y] - low) / height)

    for i, v in enumerate(vertices):
        layout.pack_into(ply, begin + i * layout.size, *v)
    with open(target, "wb") as file:
        file.write(ply)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
