"""Takes the bow out of scan.laz: the best quadratic surface through the samples becomes flat."""

import numpy as np

import simod

m = simod.open("scan.laz")
s = m.sample(50_000, progress=True)
x, y, z = (s.rest - s.rest.mean(axis=0)).T
terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
bow, *_ = np.linalg.lstsq(terms, z, rcond=None)
s.points[:, 2] -= terms @ bow
print(m.apply(s, "flat.laz", progress=True))
