"""What a site will cost in time and memory, before work starts."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from workbench.params import Parameters
from workbench.photographs import photograph_size
from workbench.site.model import Photograph, Site
from workbench.site.overlap import ground_height, has_ground_height

# CPU seconds and megabytes of trial runs; see estimate_cost for what they multiply.
_FEATURES_PER_MEGAPIXEL = 0.6
_MATCH_PER_PAIR = 0.12
_MAPPING_PER_PHOTOGRAPH = 0.7
_DENSE_PER_MEGAPIXEL = 0.7
_SURFACE_PER_MEGAPIXEL = 0.6
_MOSAIC_PER_MEGAPIXEL = 0.8
_BASE_MEMORY = 900.0
_USUAL_MEGAPIXELS = 2.25  # Of a reduced photograph in the trials: smaller ones have fewer features.
_FEATURES_MEMORY_PER_MEGAPIXEL = 260.0
_DECODED_MEMORY_PER_MEGAPIXEL = 40.0


@dataclass(frozen=True)
class CostEstimate:
    """Time and memory to expect; within a factor of about two on another machine."""

    seconds: dict[str, float]
    """Wall seconds by stage, with the threads that were assumed."""
    peak_memory_mb: float
    """Largest memory of any stage, megabytes."""
    threads: int
    """Threads that were assumed."""

    @property
    def total_seconds(self) -> float:
        """Wall seconds of the whole chain."""
        return sum(self.seconds.values())

    def __str__(self) -> str:
        stages = ", ".join(f"{stage} {_duration(value)}" for stage, value in self.seconds.items())
        return (
            f"expected time {_duration(self.total_seconds)} on {self.threads} thread(s) ({stages}); "
            f"expected memory {self.peak_memory_mb / 1000:.1f} GB"
        )


def estimate_cost(site: Site, parameters: Parameters, *, threads: int | None = None) -> CostEstimate:
    """Estimate time and memory of orientation, matching, surface and mosaic.

    Features cost by the megapixels that are looked at, candidate pairs and mapping by their number;
    matching by the megapixels of all pairs at all downscales; surface and mosaic by the megapixels of
    the finest downscale and of the photographs. Coefficients come from trials with 18 photographs of
    9 megapixels; ``benchmarks/estimate.py`` compares them with any finished site.

    Parameters
    ----------
    threads
        Cores to count on; those of this machine, at most ``orient.threads``, if not given.

    Raises
    ------
    SiteError
        If a photograph is gone.
    """
    threads = threads or min(os.cpu_count() or 1, parameters.orient.threads)
    sizes = [_megapixels(site, p) for p in site.photographs]
    count, megapixels = len(sizes), float(sum(size for size, _ in sizes))
    limit = parameters.orient.max_image_size
    reduced = [size * min(1.0, limit / longest) ** 2 for size, longest in sizes]
    candidates = count * min(parameters.orient.neighbours, count - 1) / 2
    scales = _downscales(site, parameters)
    dense = megapixels / max(count, 1) * _stereo_pairs(site, parameters) * sum(1 / s**2 for s in scales)
    finest = megapixels / min(scales) ** 2
    features = min(1.0, sum(reduced) / max(count, 1) / _USUAL_MEGAPIXELS)
    cpu = {
        "orient": sum(reduced) * _FEATURES_PER_MEGAPIXEL
        + candidates * _MATCH_PER_PAIR * features**2  # Every feature is compared with every other.
        + count * _MAPPING_PER_PHOTOGRAPH * features,
        "match": dense * _DENSE_PER_MEGAPIXEL,
        "surface": finest * _SURFACE_PER_MEGAPIXEL,
        "mosaic": megapixels * _MOSAIC_PER_MEGAPIXEL,
    }
    memory = _BASE_MEMORY + max(
        max(reduced, default=0.0) * _FEATURES_MEMORY_PER_MEGAPIXEL * threads,
        max((size for size, _ in sizes), default=0.0) * _DECODED_MEMORY_PER_MEGAPIXEL * threads,
    )
    return CostEstimate({stage: value / threads for stage, value in cpu.items()}, memory, threads)


def _megapixels(site: Site, photograph: Photograph) -> tuple[float, int]:
    """Megapixels and longest edge of a photograph."""
    camera = site.cameras.get(photograph.camera)
    width, height = (camera.width, camera.height) if camera else photograph_size(photograph.path)
    return width * height / 1e6, max(width, height)


def _downscales(site: Site, parameters: Parameters) -> tuple[int, ...]:
    from workbench.matching.levels import choose_downscales  # Matching is built upon sites.

    if parameters.match.downscales:
        return parameters.match.downscales
    if not has_ground_height(site):
        return 1, 2, 3
    ground = ground_height(site)[0]
    resolutions = [
        (p.position[2] - ground) / site.cameras[p.camera].focal_x
        for p in site.photographs
        if p.position is not None and p.camera in site.cameras and p.position[2] > ground
    ]
    return choose_downscales(float(np.median(resolutions))) if resolutions else (1, 2, 3)


def _stereo_pairs(site: Site, parameters: Parameters) -> int:
    """Pairs along the strips, and one neighbour in the next strip where across is on."""
    strips: dict[int, int] = {}
    for p in site.photographs:
        strips[p.strip] = strips.get(p.strip, 0) + 1
    pairs = sum(max(n - step, 0) for n in strips.values() for step in range(1, parameters.match.inflight + 1))
    return pairs + (2 * len(site.photographs) if parameters.match.across else 0)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
