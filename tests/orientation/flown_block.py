"""Camera, place and height of the virtual block that the tests of this folder fly."""

import numpy as np

from workbench.cameras import Camera

CAMERA = Camera("cam", 4000, 3000, 3000.0, 3000.0, 2000.0, 1500.0)
OFFSET = np.array([500_000.0, 5_000_000.0, 0.0])
HEIGHT = 90.0
GSD = HEIGHT / CAMERA.focal_x
