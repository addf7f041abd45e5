"""Compare the matcher with OpenCV's StereoSGBM in all modes, on pairs whose disparities are known exactly.

CPU time of the process and errors against the truth. Run all engines in one process on one machine;
only ratios of times carry over to another one. ``--photograph`` paints a real photograph on the surfaces.
Pandora with libsgm needs other versions of our libraries, so it runs in an environment of its own, see
matching_pandora.py: ``--export`` writes the pairs, ``--peers`` reads what it found. ``--public`` matches
the motorcycle of Middlebury (2014, in scikit-image), a real pair that is not from here.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from skimage import data

from workbench.matching import match_pair
from workbench.matching.opencv import match_with_opencv
from workbench.matching.pair import prepare_pair
from workbench.params.match import SgmParameters
from workbench.virtual.stereo_pairs import (
    Layer,
    Radiometry,
    StereoPairTruth,
    curved_pair,
    layered_pair,
    noise_texture,
)

RANGE = (0, 127)
OFF = 1.0  # Pixels from the truth that count as wrong.


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rolling ground."""
    return 60 + 20 * np.sin(x / 83 + y / 190) + 20 * np.cos(y / 71 - x / 140)


def crowns(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Closely set bumps, as a canopy from far away."""
    return 50 + 0.02 * y + 4 * np.abs(np.sin(x / 19 + 0.5 * np.sin(y / 40)) * np.sin(y / 23))


def slant(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A steep plane: no disparity is repeated by its neighbour."""
    return 10 + 0.1 * x + 0.01 * y


def steps(size: int, seed: int) -> list[Layer]:
    """Boxes and discs at many depths in front of a slanted ground."""
    random = np.random.default_rng(seed)
    layers = [Layer((20.0, 0.01, 0.005))]
    for k in range(24):
        layers.append(
            Layer(
                (random.uniform(35, 110), random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05)),
                (random.uniform(0, size), random.uniform(0, size)),
                (random.uniform(20, 90), random.uniform(20, 90)),
                bool(k % 2),
            )
        )
    return layers


def scenes(size: int, texture: np.ndarray, seed: int) -> dict[str, StereoPairTruth]:
    """Independent kinds of pairs."""
    return {
        "waves": curved_pair(texture, waves, size, seed=seed),
        "slant": curved_pair(texture, slant, size, seed=seed),
        "crowns": curved_pair(texture, crowns, size, seed=seed),
        "crowns, gain 0.7, offset 20": curved_pair(
            texture, crowns, size, Radiometry(gain=0.7, offset=20), seed=seed
        ),
        "waves, blurred": curved_pair(texture, waves, size, Radiometry(blur=1.2), seed=seed),
        "steps": layered_pair(texture, steps(size, seed), size, seed=seed),
        "steps, blurred": layered_pair(texture, steps(size, seed + 1), size, Radiometry(blur=1.0), seed=seed),
    }


def engines() -> dict[str, Callable[[StereoPairTruth], np.ndarray]]:
    """Own matcher and peers: pair in, disparity with NaN out."""
    parameters = SgmParameters()

    def own(pair: StereoPairTruth) -> np.ndarray:
        return match_pair(pair.left, pair.right, RANGE).disparity.values

    def peer(mode: str) -> Callable[[StereoPairTruth], np.ndarray]:
        return lambda pair: match_with_opencv(
            prepare_pair(pair.left, pair.right), *RANGE, parameters, mode=mode
        )

    return {"workbench": own} | {f"opencv {mode}": peer(mode) for mode in ("hh", "hh4", "sgbm", "3way")}


def errors(found: np.ndarray, pair: StereoPairTruth) -> dict[str, float]:
    """Errors where both photographs see the point, and what was invented where one does not."""
    known = np.isfinite(found)
    seen = known & pair.visible
    error = (found - pair.disparity)[seen]
    middle = np.median(error)
    phase = (pair.disparity - np.floor(pair.disparity))[seen]
    return {
        "found_%": 100 * seen.sum() / pair.visible.sum(),
        "nmad_px": 1.4826 * np.median(np.abs(error - middle)),
        "bias_px": middle,
        "off_%": 100 * (np.abs(error) > OFF).mean(),
        "off_of_all_%": 100
        * ((np.abs(found - pair.disparity) > OFF) & known).sum()
        / found.size,  # hidden ones included
        "locking_px": np.ptp([np.median(error[np.floor(phase * 8) == k]) for k in range(8)]),
    }


def textures_of(size: int, photograph: Path | None, seed: int) -> dict[str, np.ndarray]:
    """What is painted on the surfaces."""
    textures = {"noise": noise_texture((size, size + 400), seed)}
    if photograph is not None:
        image = cv2.imread(str(photograph), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise SystemExit(f"{photograph}: not an image that OpenCV reads.")
        scale = (size + 400) / image.shape[1]
        reduced = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        tall = np.concatenate([reduced, reduced[::-1]] * (size // len(reduced) + 1))[:size]
        textures["photograph"] = tall.astype(np.float32)
    return textures


def export(size: int, photograph: Path | None, seed: int, folder: Path) -> None:
    """Write all pairs for peers that run elsewhere."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, texture in textures_of(size, photograph, seed).items():
        for name, pair in scenes(size, texture, seed).items():
            np.savez(folder / f"{kind} {name}.npz", left=pair.left, right=pair.right, limits=RANGE)


def compare(size: int, photograph: Path | None, repeats: int, seed: int, peers: Path | None) -> pd.DataFrame:
    """One row per scene and engine."""
    rows = []
    for kind, texture in textures_of(size, photograph, seed).items():
        for name, pair in scenes(size, texture, seed).items():
            for engine, match in engines().items():
                match(pair)  # Compilation and caches.
                spent = []
                for _ in range(repeats):
                    start = time.process_time()
                    found = match(pair)
                    spent.append(time.process_time() - start)
                rows.append({"texture": kind, "scene": name, "engine": engine, "cpu_s": min(spent)})
                rows[-1] |= errors(found, pair)
            stored = (peers or Path()) / f"{kind} {name}.peer.npz"
            if peers is not None and stored.exists():
                peer = np.load(stored)
                rows.append({"texture": kind, "scene": name, "engine": str(peer["engine"])})
                rows[-1] |= {"cpu_s": float(peer["cpu_s"])} | errors(peer["disparity"], pair)
    return pd.DataFrame(rows)


def public() -> pd.DataFrame:
    """A public pair with measured truth: the motorcycle of Middlebury, in every form a user may bring it."""
    left, right, truth = data.stereo_motorcycle()
    known = np.isfinite(truth) & (truth > 0)
    limits = (0, int(truth[known].max()) + 8)
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]

    def own(first: np.ndarray, second: np.ndarray, limits: tuple[int, int] = limits, **options: Any):
        return match_pair(first, second, limits, parameters=SgmParameters(**options)).disparity.values

    def mirrored() -> np.ndarray:
        # Both images turned by half a turn and exchanged are a pair again.
        return own(right[::-1, ::-1], left[::-1, ::-1])[::-1, ::-1]

    def peer(mode: str) -> np.ndarray:
        return match_with_opencv(prepare_pair(*grey), *limits, SgmParameters(), mode=mode)

    trials: dict[str, Callable[[], np.ndarray]] = {
        "workbench, RGB": lambda: own(left, right),
        "grey, 8 bit": lambda: own(*grey),
        "grey, 0..1": lambda: own(*(image / 255 for image in grey)),
        "range -300..300": lambda: own(left, right, (-300, 300)),
        "16 paths": lambda: own(left, right, paths=16),
        "census 5 x 5": lambda: own(left, right, cost="census5x5"),
        "mutual information": lambda: own(left, right, cost="mutual_information"),
        "fit instead of least squares": lambda: own(left, right, subpixel=False),
        "right one 1.7 times brighter": lambda: own(left, np.clip(right * 1.7, 0, 255)),
        "right one as the base, negative": lambda: -own(right, left, (-limits[1], 0)),
        "turned and exchanged": mirrored,
    }
    trials |= {f"opencv {mode}": lambda mode=mode: peer(mode) for mode in ("hh", "hh4", "sgbm", "3way")}
    rows = []
    for name, match in trials.items():
        match()
        start = time.process_time()
        found = match()
        spent = time.process_time() - start
        error = found - truth
        if "base" in name or "exchanged" in name:
            # The truth belongs to the left image: only how much was found can be told.
            rows.append({"engine": name, "cpu_s": spent, "found_%": 100 * np.isfinite(found).mean()})
            continue
        seen = known & np.isfinite(found)
        rows.append(
            {
                "engine": name,
                "cpu_s": spent,
                "found_%": 100 * seen.sum() / known.sum(),
                "nmad_px": 1.4826 * np.median(np.abs(error[seen] - np.median(error[seen]))),
                "off_1_%": 100 * (np.abs(error[seen]) > 1).mean(),
                "off_2_%": 100 * (np.abs(error[seen]) > 2).mean(),
                "right_of_all_%": 100 * (np.abs(error[seen]) <= 2).sum() / known.sum(),
            }
        )
    return pd.DataFrame(rows)


def memory(rows: int, columns: int, disparities: int) -> None:
    """Peak memory of a large pair."""
    texture = noise_texture((rows // 4, columns // 4 + 100), 0, (1, 4))
    large = cv2.resize(texture, None, fx=4, fy=4, interpolation=cv2.INTER_LINEAR)
    large += np.random.default_rng(0).normal(size=large.shape).astype(np.float32) * 10
    left, right = (np.clip(large[:, start : start + columns], 0, 255).astype(np.uint8) for start in (0, 120))
    del large, texture
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    start, cpu = time.perf_counter(), time.process_time()
    result = match_pair(left, right, (0, disparities - 1))
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{rows * columns / 1e6:.0f} Mpx x {disparities}: {wall:.1f} s, {cpu:.1f} CPU-s, peak {peak:.2f} GB "
        f"({before:.2f} before), median disparity {float(result.disparity.median()):.3f} (true 120)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1000, help="edge of the square images, px")
    parser.add_argument("--photograph", type=Path, help="photograph to paint on the surfaces")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--csv", type=Path, help="also write the table here")
    parser.add_argument("--export", type=Path, help="only write the pairs into this folder")
    parser.add_argument("--peers", type=Path, help="folder with what peers found on exported pairs")
    parser.add_argument("--memory", action="store_true", help="only the peak memory of 12 Mpx x 256")
    parser.add_argument("--public", action="store_true", help="only the public pair")
    options = parser.parse_args()
    if options.public:
        print(public().round(3).to_string(index=False))
        return
    if options.memory:
        memory(3000, 4000, 256)
        return
    if options.export:
        export(options.size, options.photograph, options.seed, options.export)
        return
    table = compare(options.size, options.photograph, options.repeats, options.seed, options.peers)
    if options.csv:
        table.to_csv(options.csv, index=False)
    print(table.round(3).to_string(index=False))
    times = table.groupby("engine")["cpu_s"].median()
    print("\nCPU time, median over scenes, and relative to opencv hh:")
    print(pd.DataFrame({"cpu_s": times, "ratio": times / times["opencv hh"]}).round(3).to_string())


if __name__ == "__main__":
    main()
