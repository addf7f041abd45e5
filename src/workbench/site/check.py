"""Everything that is wrong with a site, at once, each with its remedy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from workbench.errors import SiteError
from workbench.params import Parameters
from workbench.site.check_control import control_problems
from workbench.site.estimate import CostEstimate, estimate_cost
from workbench.site.model import Problem, Site
from workbench.site.overlap import Overlap, has_ground_height, overlap_map
from workbench.site.places import far_from_rest, outside_area

_LEAST_PHOTOGRAPHS = 3
_LEAST_FORWARD = 0.5  # Below, no point of the ground is seen by three photographs of a strip.
_LEAST_ACROSS = 0.2  # Below, wind and relief open gaps between strips.


@dataclass(frozen=True)
class CheckReport:
    """All problems of a site, and what it will cost to process."""

    site: str
    """Name of the site."""
    photographs: int
    """Photographs in use."""
    strips: int
    """Flight strips found."""
    problems: tuple[Problem, ...]
    """Errors first."""
    overlap: Overlap | None = None
    """Overlap on level ground; None where positions, cameras or the height of the ground are unknown."""
    cost: CostEstimate | None = None
    """Time and memory to expect; None without parameters or photographs."""

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Problems that stop the chain."""
        return tuple(problem for problem in self.problems if problem.severity == "error")

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Problems that the chain can live with."""
        return tuple(problem for problem in self.problems if problem.severity == "warning")

    def __str__(self) -> str:
        head = f"{self.site}: {self.photographs} photographs in {self.strips} strip(s), "
        head += f"{len(self.errors)} error(s), {len(self.warnings)} warning(s)"
        facts = [str(fact) for fact in (self.overlap, self.cost) if fact is not None]
        return "\n".join([head, *map(str, self.problems), *facts])


def check_site(site: Site, parameters: Parameters | None = None) -> CheckReport:
    """List every problem of a site; photographs that were set aside are among them.

    Parameters
    ----------
    site
        As loaded.
    parameters
        With them, time and memory are estimated.
    """
    problems = [
        *_questions(site),
        *_photographs(site),
        *_positions(site),
        *_missing(site),
        *control_problems(site),
    ]
    present = [p for p in site.photographs if p.position is not None and p.camera in site.cameras]
    overlap = None
    if present and site.crs is not None and has_ground_height(site):
        try:
            overlap = overlap_map(site)
        except SiteError as error:
            problems.append(
                Problem("warning", str(site.folder / "photographs.csv"), f"{error}", "Correct one of them.")
            )
        else:
            problems += _overlaps(site, overlap)
    problems.sort(key=lambda problem: problem.severity != "error")
    strips = {p.strip for p in site.photographs if p.position}
    cost = estimate_cost(site, parameters) if parameters is not None and site.photographs else None
    return CheckReport(site.name, len(site.photographs), len(strips), tuple(problems), overlap, cost)


def _questions(site: Site) -> Iterator[Problem]:
    for question in site.unanswered:
        subject, _, text = question.partition(": ")
        yield Problem("error", subject, text, "Answer it there.")


def _photographs(site: Site) -> Iterator[Problem]:
    listing = str(site.folder / "photographs.csv")
    for p in site.set_aside:
        yield Problem("warning", p.name, f"set aside: {p.set_aside}.", "The others go on without it.")
    for p in site.photographs:
        if not p.path.exists():
            yield Problem("error", p.name, f"{p.path} is gone.", "Restore it, or run new-site again.")
        if p.camera not in site.cameras and not _is_asked(site, p.camera):
            yield Problem(
                "error",
                p.name,
                f"its camera '{p.camera}' is not in site.yaml.",
                "Add it, or run new-site again.",
            )
    if len(site.photographs) < _LEAST_PHOTOGRAPHS:
        yield Problem(
            "error",
            listing,
            f"only {len(site.photographs)} usable photograph(s).",
            f"At least {_LEAST_PHOTOGRAPHS} overlapping ones are needed.",
        )
    yield from _several_cameras(site, listing)
    bare = [p.name for p in site.photographs if p.position is None and p.time is None and not p.note]
    if bare and len(bare) == len(site.photographs):
        yield Problem(
            "warning",
            listing,
            "no photograph tells where or when it was taken (no EXIF).",
            "Strips and the sun stay unknown; give a navigation file if there is one.",
        )
    if any(p.time is not None and p.time.tzinfo is None for p in site.photographs):
        yield Problem(
            "warning",
            str(site.folder / "site.yaml"),
            "the clock of the camera has no time zone, so the sun's position is unknown.",
            "State time_zone, for example Europe/Berlin.",
        )


def _is_asked(site: Site, camera: str) -> bool:
    return any(f"cameras.{camera}." in question for question in site.unanswered)


def _several_cameras(site: Site, listing: str) -> Iterator[Problem]:
    cameras = Counter(p.camera for p in site.photographs)
    if len(cameras) < 2:
        return
    counts = ", ".join(f"{camera}: {count}" for camera, count in sorted(cameras.items()))
    yield Problem("warning", listing, f"several cameras ({counts}).", "Each is calibrated on its own.")
    sizes: dict[str, set[tuple[int, int]]] = {}
    for camera in site.cameras.values():
        sizes.setdefault(camera.name, set()).add((camera.width, camera.height))
    for name, several in sizes.items():
        if len(several) > 1:
            listed = ", ".join(f"{width} x {height}" for width, height in sorted(several))
            yield Problem(
                "warning",
                listing,
                f"photographs of {name} have several sizes ({listed}).",
                "If some were cropped or resized by a program, use the originals.",
            )


def _positions(site: Site) -> Iterator[Problem]:
    listing = str(site.folder / "photographs.csv")
    for p in site.photographs:
        if p.note:
            yield Problem("warning", p.name, f"{p.note}.", "The photograph is used without it.")
    placed = [p for p in site.photographs if p.position is not None]
    lacking = len(site.photographs) - len(placed)
    if lacking and placed:
        yield Problem(
            "warning", listing, f"{lacking} photograph(s) have no position.", "All pairs with them are tried."
        )
    if len(placed) < 3 and len(site.control) < 3:
        yield Problem(
            "error",
            listing,
            f"{len(placed)} photograph(s) have a position and there are {len(site.control)} control points.",
            "Three of either are needed: give a navigation file or control points with observations.",
        )
    xy = np.array([p.position[:2] for p in placed if p.position is not None], dtype=np.float64).reshape(-1, 2)
    for p, far in zip(placed, far_from_rest(xy), strict=True):
        if far:
            yield Problem(
                "error",
                p.name,
                f"its position is {np.hypot(*(xy[placed.index(p)] - np.median(xy, axis=0))) / 1000:.1f} km "
                "from the others.",
                "It may be zero or swapped; mend or empty it in photographs.csv.",
            )
    if site.crs is not None and len(xy):
        outside = outside_area(xy, CRS.from_user_input(site.crs))
        if outside.any():
            yield Problem(
                "error",
                listing,
                f"{outside.sum()} position(s) lie outside of the area of {site.crs}, the first is "
                f"{placed[int(np.argmax(outside))].name}.",
                "x and y may be swapped, or the zone is another one.",
            )


def _missing(site: Site) -> Iterator[Problem]:
    if site.shoreline is not None and site.water_level is None:
        yield Problem(
            "warning",
            str(site.folder / "site.yaml"),
            "there is a shoreline but no water_level.",
            "State it, or reed is not measured.",
        )


def _overlaps(site: Site, overlap: Overlap) -> Iterator[Problem]:
    listing = str(site.folder / "photographs.csv")
    for name in overlap.isolated:
        yield Problem(
            "warning",
            name,
            "it shares less than a tenth of its footprint with any other photograph.",
            "It will hardly be oriented; is its position right?",
        )
    if overlap.forward < _LEAST_FORWARD:
        yield Problem(
            "warning",
            listing,
            f"forward overlap is {100 * overlap.forward:.0f} %.",
            "Below 50 % the ground is seen by two photographs only and strips may fall apart; fly 80 %.",
        )
    if overlap.across < _LEAST_ACROSS:
        yield Problem(
            "warning",
            listing,
            f"overlap between strips is {100 * overlap.across:.0f} %.",
            "Below 20 % strips may come apart and gaps open; fly 60 %.",
        )
