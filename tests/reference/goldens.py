"""What the scripts of this folder share: rotations, hashes, and files of golden figures that a person can read."""

import json
import re

import numpy as np


def rotation(axis, degrees):
    """Turns about an axis: three rows of three."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(degrees)
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


def fingerprint(*arrays):
    """FNV-1a over arrays one after the other: floats in single precision, integers of 32 bits, little-endian."""
    h = 0xCBF29CE484222325
    for array in arrays:
        for byte in array.astype("<f4" if array.dtype.kind == "f" else "<i4").tobytes():
            h = (h ^ byte) * 0x100000001B3 % 2**64
    return f"{h:016x}"


def read(path):
    """The figures that are there so far."""
    return json.loads(path.read_text()) if path.exists() else {}


def write(path, figures):
    """Points, and rows of a matrix, on one line each."""
    number = r"([-\d.e]+)"
    text = json.dumps(figures, indent=1)
    for count in (3, 4):
        row = r",\s+".join([number] * count)
        text = re.sub(rf"\[\s+{row}\s+\]", "[" + ", ".join(rf"\{k + 1}" for k in range(count)) + "]", text)
    path.write_text(text + "\n")
