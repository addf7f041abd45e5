"""Pandora with libsgm on pairs that benchmarks/matching.py exported; runs in an environment of its own.

    uv venv peer
    uv pip install --python peer pandora pandora-plugin-libsgm opencv-python-headless==4.12.0.88
    python benchmarks/matching.py --export pairs
    peer/bin/python benchmarks/matching_pandora.py pairs
    python benchmarks/matching.py --peers pairs

Census 5 x 5 (its largest), 8 paths, V-fit, median, cross-checking: the chain of its documentation.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pandora

PIPELINE = {
    "matching_cost": {"matching_cost_method": "census", "window_size": 5, "subpix": 1},
    "optimization": {"optimization_method": "sgm", "penalty": {"penalty_method": "sgm_penalty"}},
    "disparity": {"disparity_method": "wta", "invalid_disparity": "NaN"},
    "refinement": {"refinement_method": "vfit"},
    "filter": {"filter_method": "median", "filter_size": 3},
    "validation": {"validation_method": "cross_checking_accurate", "cross_checking_threshold": 1.0},
}
_INVALID = 0b11111  # Bits of its validity mask that say that a disparity is not to be used.
_MISMATCH = 0b1100000000  # Occlusion and mismatch found by cross-checking.


def main() -> None:
    for path in sorted(Path(sys.argv[1]).glob("*.npz")):
        if path.name.endswith(".peer.npz"):
            continue
        pair = np.load(path)
        match(pair)  # Compilation and caches.
        started = time.process_time()
        disparity = match(pair)
        spent = time.process_time() - started
        np.savez(path.with_suffix(".peer.npz"), disparity=disparity, cpu_s=spent, engine="pandora libsgm")
        print(path.name, f"{spent:.1f} CPU-s", f"{np.isfinite(disparity).mean():.1%} found")


def match(pair: np.lib.npyio.NpzFile) -> np.ndarray:
    """Disparity in the sign of the workbench, NaN where invalid."""
    low, high = (int(limit) for limit in pair["limits"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for side in ("left", "right"):
            cv2.imwrite(str(folder / f"{side}.tif"), pair[side])
        inputs = {
            "left": {"img": str(folder / "left.tif"), "disp": [-high, -low], "nodata": -9999},
            "right": {"img": str(folder / "right.tif"), "nodata": -9999},
        }
        config = folder / "config.json"
        config.write_text(json.dumps({"input": inputs, "pipeline": PIPELINE}))
        pandora.main(str(config), str(folder / "out"), verbose=False)
        found = cv2.imread(str(folder / "out" / "left_disparity.tif"), cv2.IMREAD_UNCHANGED)
        mask = cv2.imread(str(folder / "out" / "left_validity_mask.tif"), cv2.IMREAD_UNCHANGED)
    return np.where(mask & (_INVALID | _MISMATCH), np.nan, -found).astype(np.float32)


if __name__ == "__main__":
    main()
