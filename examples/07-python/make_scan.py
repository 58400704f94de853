"""Makes scan.laz: a ground of two million points, which a drifting scanner has bowed by metres over 100 metres."""

import subprocess

import simod

subprocess.run(["simod", "generate", "--shape", "bumpy-plane", "--vertices", "2000000", "-o", "ground.ply"], check=True)
m = simod.open("ground.ply")
s = m.sample(50_000)
s.points *= 50                                   # a hundred metres
s.points = s.points[:, [2, 0, 1]]                # z is up
s.points[:, 2] += 2e-3 * s.points[:, 0] ** 2 + 1e-3 * s.points[:, 0] * s.points[:, 1]
m.apply(s, "bowed.ply")
subprocess.run(["simod", "convert", "bowed.ply", "scan.laz", "--lossy"], check=True)
