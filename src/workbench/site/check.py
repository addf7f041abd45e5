"""Everything that is wrong with a site, at once, each with its remedy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

import numpy as np

from workbench.params import Parameters
from workbench.site.model import Site

_LEAST_PHOTOGRAPHS = 3
_FAR = 20.0  # Robust distances: a position this many times the usual spread away is no neighbour.


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong."""

    severity: Literal["error", "warning"]
    """error: the chain cannot run; warning: it can, with less."""
    subject: str
    """File, photograph or point."""
    text: str
    """What is wrong."""
    remedy: str
    """What to do."""

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text} {self.remedy}"


@dataclass(frozen=True)
class CheckReport:
    """All problems of a site."""

    site: str
    """Name of the site."""
    photographs: int
    """Photographs in use."""
    strips: int
    """Flight strips found."""
    problems: tuple[Problem, ...]
    """Errors first."""

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Problems that stop the chain."""
        return tuple(problem for problem in self.problems if problem.severity == "error")

    def __str__(self) -> str:
        head = f"{self.site}: {self.photographs} photographs in {self.strips} strip(s), "
        head += f"{len(self.errors)} error(s), {len(self.problems) - len(self.errors)} warning(s)"
        return "\n".join([head, *map(str, self.problems)])


def check_site(site: Site, parameters: Parameters | None = None) -> CheckReport:
    """List every problem of a site; photographs that were set aside are among them.

    Parameters
    ----------
    site
        As loaded.
    parameters
        Checked when they were read; with them, stages that lack inputs are named.
    """
    problems = [
        *_questions(site),
        *_photographs(site),
        *_positions(site),
        *_control(site),
    ]
    problems.sort(key=lambda problem: problem.severity != "error")
    strips = {p.strip for p in site.photographs if p.position}
    return CheckReport(site.name, len(site.photographs), len(strips), tuple(problems))


def _questions(site: Site) -> list[Problem]:
    return [
        Problem("error", question.split(": ")[0], ": ".join(question.split(": ")[1:]), "Answer it there.")
        for question in site.unanswered
    ]


def _photographs(site: Site) -> list[Problem]:
    problems = [
        Problem("warning", p.name, f"set aside: {p.set_aside}.", "The others go on without it.")
        for p in site.set_aside
    ]
    listing = str(site.folder / "photographs.csv")
    problems += [
        Problem("error", p.name, f"{p.path} is gone.", "Restore it, or run new-site again.")
        for p in site.photographs
        if not p.path.exists()
    ]
    if len(site.photographs) < _LEAST_PHOTOGRAPHS:
        problems.append(
            Problem(
                "error",
                listing,
                f"only {len(site.photographs)} usable photograph(s).",
                f"At least {_LEAST_PHOTOGRAPHS} overlapping ones are needed.",
            )
        )
    cameras = Counter(p.camera for p in site.photographs)
    if len(cameras) > 1:
        counts = ", ".join(f"{camera}: {count}" for camera, count in sorted(cameras.items()))
        problems.append(
            Problem("warning", listing, f"several cameras ({counts}).", "Each is calibrated on its own.")
        )
    return problems


def _positions(site: Site) -> list[Problem]:
    listing = str(site.folder / "photographs.csv")
    placed = [p for p in site.photographs if p.position is not None]
    lacking = len(site.photographs) - len(placed)
    problems = []
    if lacking and placed:
        problems.append(
            Problem(
                "warning",
                listing,
                f"{lacking} photograph(s) have no position.",
                "All pairs with them are tried.",
            )
        )
    if not placed and len(site.control) < 3:
        problems.append(
            Problem(
                "error",
                listing,
                "no photograph has a position and there are fewer than three control points.",
                "Give a navigation file or control points with observations.",
            )
        )
    if len(placed) >= 4:
        xy = np.array([p.position[:2] for p in placed])  # type: ignore[index]
        away = np.hypot(*(xy - np.median(xy, axis=0)).T)
        usual = max(float(np.median(away)), 1.0)
        problems += [
            Problem(
                "error",
                p.name,
                f"its position is {distance / 1000:.1f} km from the others.",
                "Its coordinates may be zero or swapped; mend or delete them in photographs.csv.",
            )
            for p, distance in zip(placed, away, strict=True)
            if distance > _FAR * usual
        ]
    return problems


def _control(site: Site) -> list[Problem]:
    file, observed_in = str(site.folder / "control.csv"), str(site.folder / "observations.csv")
    problems = []
    names = {point.name for point in site.control}
    photos = {p.name for p in site.photographs}
    seen = Counter(o.name for o in site.observations if o.photo in photos)
    for observation in site.observations:
        subject = f"{observed_in} ({observation.name} in {observation.photo})"
        if observation.name not in names:
            problems.append(Problem("warning", subject, "no such control point.", "Add it to control.csv."))
        if observation.photo not in photos:
            problems.append(Problem("warning", subject, "no such photograph in use.", "Mend the name."))
            continue
        camera = site.cameras.get(site.photograph(observation.photo).camera)
        inside = camera is None or (
            0 <= observation.column <= camera.width and 0 <= observation.row <= camera.height
        )
        if not inside:
            problems.append(Problem("error", subject, "lies outside the photograph.", "Mend or delete it."))
    for point in site.control:
        if seen[point.name] < 2:
            problems.append(
                Problem(
                    "warning",
                    f"{file} ({point.name})",
                    f"observed in {seen[point.name]} photograph(s).",
                    "It is not used: measure it in at least two.",
                )
            )
    return problems + _control_places(site, file)


def _control_places(site: Site, file: str) -> list[Problem]:
    """Points that lie away from the block: swapped axes or the wrong zone."""
    placed = np.array([p.position for p in site.photographs if p.position is not None])
    if not len(placed) or not site.control:
        return []
    low, high = placed[:, :2].min(axis=0), placed[:, :2].max(axis=0)
    reach = max(float(np.hypot(*(high - low))), 100.0)
    problems = []
    for point in site.control:
        subject = f"{file} ({point.name})"
        place = np.array([point.x, point.y])

        def inside(candidate: np.ndarray) -> bool:
            return bool(np.all(candidate > low - reach) and np.all(candidate < high + reach))

        if inside(place):
            continue
        if inside(place[::-1]):
            text, remedy = "x and y are swapped.", "Exchange the two columns."
        elif abs(point.y - placed[:, 1].mean()) < 50_000 and abs(point.x - placed[:, 0].mean()) > 50_000:
            text = f"{abs(point.x - placed[:, 0].mean()) / 1000:.0f} km east or west of the photographs."
            remedy = f"It may be in another UTM zone: transform it to {site.crs}."
        else:
            away = np.hypot(*(place - placed[:, :2].mean(axis=0))) / 1000
            text = f"{away:.1f} km from the photographs."
            remedy = f"Check its CRS ({site.crs} is expected)."
        problems.append(Problem("error", subject, text, remedy))
    return problems
