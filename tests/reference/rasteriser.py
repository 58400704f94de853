"""A small rasteriser of Gaussian splats in numpy: parallel projection, splats in order of depth, no tricks."""

import numpy as np


class View:
    """A view of points from aslant above, which all of them are in."""

    def __init__(self, points, size=400):
        self.direction = np.array([0.5, 0.6, -0.62])
        self.direction /= np.linalg.norm(self.direction)
        right = np.cross(self.direction, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(right, self.direction)])
        flat = points @ self.axes.T
        self.low = flat.min(0)
        self.scale = 0.94 * size / (flat.max(0) - self.low).max()
        self.low = self.low - 0.03 * size / self.scale
        self.size = size

    def draw(self, centres, covariances, colours, opacities):
        """The picture over black: rows of pixels, three numbers each."""
        place = (centres @ self.axes.T - self.low) * self.scale
        flat = np.einsum("ai,sij,bj->sab", self.axes, covariances, self.axes) * self.scale**2
        # As the reference implementation does, so that no splat falls between pixels.
        flat += 0.3 * np.eye(2)
        inverse = np.linalg.inv(flat)
        reach = 3 * np.sqrt(np.linalg.eigvalsh(flat)[:, 1])
        picture = np.zeros((self.size, self.size, 3))
        left = np.ones((self.size, self.size))
        for i in np.argsort(centres @ self.direction, kind="stable"):
            x0, y0 = np.maximum(np.floor(place[i] - reach[i]).astype(int), 0)
            x1, y1 = np.minimum(np.ceil(place[i] + reach[i]).astype(int) + 1, self.size)
            if x0 >= x1 or y0 >= y1:
                continue
            dx = np.arange(x0, x1) - place[i, 0]
            dy = np.arange(y0, y1)[:, None] - place[i, 1]
            (a, b), (_, c) = inverse[i]
            alpha = np.minimum(opacities[i] * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy)), 0.99)
            window = (slice(y0, y1), slice(x0, x1))
            picture[window] += (left[window] * alpha)[:, :, None] * colours[i]
            left[window] *= 1 - alpha
        return picture
