"""Binary little-endian PLY files, as SIMOD writes them: their vertices, as a structured array, and what is around these."""

import numpy as np

TYPES = {
    "double": "<f8",
    "float": "<f4",
    "int": "<i4",
    "uint": "<u4",
    "short": "<i2",
    "ushort": "<u2",
    "char": "i1",
    "uchar": "u1",
}
END = b"end_header\n"


def read(path):
    """The file's bytes, where its vertices begin, and a copy of these."""
    data = path.read_bytes()
    start = data.index(END) + len(END)
    fields, count, is_vertex = [], 0, False
    for line in data[:start].decode().splitlines():
        words = line.split()
        if words[0] == "element":
            is_vertex = words[1] == "vertex"
            count = int(words[2]) if is_vertex else count
        if words[0] == "property" and is_vertex:
            fields.append((words[2], TYPES[words[1]]))
    return data, start, np.frombuffer(data, np.dtype(fields), count, start).copy()


def write(path, data, start, points):
    """The file that was read, with other vertices."""
    path.write_bytes(data[:start] + points.tobytes() + data[start + points.nbytes :])


def vertices(path):
    """The vertices alone."""
    return read(path)[2]
