"""Land surface: a fractal of controlled relief on an inclined plane."""

from __future__ import annotations

import numpy as np

from workbench.virtual.composition import TerrainSpec
from workbench.virtual.noise import fractal_field


def land_heights(spec: TerrainSpec, x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Heights (rows, columns), m, at the nodes of a raster; ``x`` and ``y`` its local axes, m.

    Octaves halve in length and lose 55 % of their amplitude, down to 4 m: gentle forms without steps.
    The mean over the scene is the base plus the inclined plane.
    """
    generator = np.random.default_rng([seed, 1])
    field = fractal_field(x[None, :], y[:, None], spec.longest, 4.0, generator, gain=0.45)
    deviation = field - field.mean()
    spread = max(float(deviation.std()), 1e-9)
    return spec.base + _plane(spec, x, y) + deviation * (spec.relief / spread)


def level_border(
    heights: np.ndarray, spec: TerrainSpec, x: np.ndarray, y: np.ndarray, size: tuple[float, float]
) -> np.ndarray:
    """Heights whose hills fade into the inclined plane from the scene of this size (m) to the last nodes.

    The renderer goes on beyond them with the height of the nearest: a hill there would become a ridge.
    """
    out_x = np.maximum(np.maximum(-x, x - size[0]), 0)
    out_y = np.maximum(np.maximum(-y, y - size[1]), 0)
    t = np.clip(np.maximum(out_x[None, :] / -x[0], out_y[:, None] / -y[0]), 0, 1)
    kept = 1 - t**2 * (3 - 2 * t)
    plane = spec.base + _plane(spec, x, y)
    return np.where(t > 0, plane + kept * (heights - plane), heights)


def _plane(spec: TerrainSpec, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return spec.slope[0] * (x[None, :] - x.mean()) + spec.slope[1] * (y[:, None] - y.mean())
