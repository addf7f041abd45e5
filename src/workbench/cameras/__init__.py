"""Cameras, poses and the geometry of a flight."""

from workbench.cameras.geometry import ground_sampling_distance, intersection_angle
from workbench.cameras.lens import Camera
from workbench.cameras.pose import Pose

__all__ = ["Camera", "Pose", "ground_sampling_distance", "intersection_angle"]
