"""Virtual landscapes and flights with known truth, written as an ordinary site."""

from workbench.virtual.flight import Flight, plan_flight
from workbench.virtual.flight_cameras import flight_camera, flight_camera_names
from workbench.virtual.render import render
from workbench.virtual.scene import Scene, build_scene, load_scene, scene_names
from workbench.virtual.stage import simulate_scene
from workbench.virtual.truth import scene_truth

__all__ = [
    "Flight",
    "Scene",
    "build_scene",
    "flight_camera",
    "flight_camera_names",
    "load_scene",
    "plan_flight",
    "render",
    "scene_names",
    "scene_truth",
    "simulate_scene",
]
