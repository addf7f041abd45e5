"""A block: photographs whose inner and outer orientation are known. What matching and mosaic work on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rasterio.crs import CRS

from workbench.cameras import Camera, Pose


@dataclass(frozen=True, eq=False)
class OrientedPhotograph:
    """One photograph with its camera and pose."""

    name: str
    """Unique name, as in the site's list of photographs."""
    path: Path
    """Image file."""
    camera: Camera
    """Inner orientation, adjusted."""
    pose: Pose
    """Outer orientation in the CRS of the block."""
    strip: int = 0
    """Number of the flight strip, from 0."""
    order: int = 0
    """Place within the strip, by time of exposure, from 0."""

    def project(self, points: np.ndarray) -> np.ndarray:
        """Image positions (n, 2), px, of world points (n, 3); NaN behind the camera."""
        return self.camera.project(self.pose.to_camera(points))

    def sees(self, points: np.ndarray) -> np.ndarray:
        """Whether world points (n, 3) fall into the frame (occlusion is not tested), (n,) bool."""
        return self.camera.contains(self.project(points))


@dataclass(frozen=True, eq=False)
class Block:
    """All oriented photographs of a site."""

    photographs: tuple[OrientedPhotograph, ...]
    """In the order of their names."""
    crs: CRS
    """Projected CRS of the poses, metres."""
    vertical_datum: str
    """Datum of the heights."""
    tie_points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    """World coordinates (n, 3) of the sparse points."""

    def __iter__(self) -> Iterator[OrientedPhotograph]:
        return iter(self.photographs)

    def __len__(self) -> int:
        return len(self.photographs)

    def __getitem__(self, name: str) -> OrientedPhotograph:
        return next(photograph for photograph in self.photographs if photograph.name == name)
