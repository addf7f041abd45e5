"""Camera poses and tie points from photographs, positions and control points."""

from workbench.orientation.block import Block, OrientedPhotograph

__all__ = ["Block", "OrientedPhotograph"]
