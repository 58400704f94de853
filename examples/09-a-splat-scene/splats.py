#!/usr/bin/env python3
"""Covers a model of `simod generate` with Gaussian splats: splats.py MODEL.ply SCENE.ply

Each vertex becomes a flat disc across its normal, of its colour, which shimmers a little: harmonics of degree 1.
"""

import math
import struct
import sys

VERTEX = struct.Struct("<6f3B")
NAMES = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
NAMES += [f"f_rest_{i}" for i in range(9)] + ["opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]


def main(source, target):
    with open(source, "rb") as file:
        header, _, data = file.read().partition(b"end_header\n")
    count = int(header.split(b"element vertex ")[1].split()[0])
    vertices = [VERTEX.unpack_from(data, i * VERTEX.size) for i in range(count)]
    # As wide as they are apart, on a surface of about 6 square units.
    size = 0.7 * math.sqrt(6 / count)
    with open(target, "wb") as file:
        properties = "".join(f"property float {name}\n" for name in NAMES)
        file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n".encode())
        for x, y, z, nx, ny, nz, *rgb in vertices:
            # The rotation from the z axis to the normal.
            w = math.sqrt(max(0.0, (1 + nz) / 2))
            turn = [w, -ny / (2 * w), nx / (2 * w), 0.0] if w > 1e-3 else [0.0, 1.0, 0.0, 0.0]
            colour = [(c / 255 - 0.5) / 0.28209479 for c in rgb]
            shimmer = [0.1 * n for n in (-ny, nz, -nx)] * 3
            scales = [math.log(size), math.log(size), math.log(0.1 * size)]
            file.write(struct.pack(f"<{len(NAMES)}f", x, y, z, 0, 0, 0, *colour, *shimmer, 3.0, *scales, *turn))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
