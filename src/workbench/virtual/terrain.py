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
    plane = spec.slope[0] * (x[None, :] - x.mean()) + spec.slope[1] * (y[:, None] - y.mean())
    deviation = field - field.mean()
    spread = max(float(deviation.std()), 1e-9)
    return spec.base + plane + deviation * (spec.relief / spread)
