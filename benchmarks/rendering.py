"""How fast virtual photographs are rendered, and how much memory a large one needs.

``python benchmarks/rendering.py`` prints megapixels per CPU second (the first, compiling photograph is
not counted) for each scene, and the peak memory of the process.
"""

from __future__ import annotations

import argparse
import resource
import time
from datetime import UTC, datetime

from workbench.cameras import Camera, Pose
from workbench.virtual.render import render
from workbench.virtual.scene import build_scene, load_scene

NOON = datetime(2015, 9, 10, 11, 0, tzinfo=UTC)


def main() -> None:
    """Render and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["meadow", "lake", "baruth", "habichtswald"])
    parser.add_argument("--gsd", type=float, default=0.15, help="ground sampling distance, m")
    parser.add_argument("--height", type=float, default=600.0, help="above ground, m")
    parser.add_argument("--columns", type=int, default=1200)
    parser.add_argument("--rows", type=int, default=900)
    parser.add_argument("--repeat", type=int, default=2)
    arguments = parser.parse_args()
    print(f"{'scene':<14}{'trees':>8}{'build s':>9}{'Mpx/CPU-s':>11}{'Mpx/s':>8}{'peak MB':>9}")
    for name in arguments.scenes:
        start = time.process_time()
        scene = build_scene(load_scene(name))
        built = time.process_time() - start
        columns, rows = arguments.columns, arguments.rows
        focal = arguments.height / arguments.gsd
        camera = Camera("benchmark", columns, rows, focal, focal, columns / 2, rows / 2, (-0.02, 0.01))
        west, south, east, north = scene.extent
        centre = ((west + east) / 2, (south + north) / 2, scene.spec.terrain.base + arguments.height)
        pose = Pose.from_omega_phi_kappa(centre, 0, 0, 0)
        small = Camera("first", 64, 64, focal, focal, 32, 32, (-0.02, 0.01))
        render(scene, small, pose, time=NOON)
        cpu, wall = time.process_time(), time.perf_counter()
        for exposure in range(arguments.repeat):
            render(scene, camera, pose, time=NOON, exposure=exposure)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        pixels = arguments.repeat * columns * rows / 1e6
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        speeds = f"{pixels / cpu:>11.2f}{pixels / wall:>8.2f}"
        print(f"{name:<14}{len(scene.trees):>8}{built:>9.1f}{speeds}{peak:>9.0f}")


if __name__ == "__main__":
    main()
