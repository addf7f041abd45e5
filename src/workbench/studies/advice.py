"""Advice from the studies: what to fly for a purpose, and what given photographs can measure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from workbench.errors import StudyError
from workbench.site import Site
from workbench.site.overlap import ground_height, overlap_map
from workbench.studies.analysis import means
from workbench.studies.collapse import Collapse, disparity_collapse
from workbench.studies.findings import TABLE
from workbench.virtual.flight_cameras import flight_camera

Purpose = Literal["conifer", "broadleaf", "reed", "orthophoto"]


@dataclass(frozen=True)
class Target:
    """What a purpose asks for, at the height of the canopy."""

    gsd: tuple[float, float]
    """Ground resolution, from and to, m."""
    angle: tuple[float, float]
    """Intersection angle of neighbouring photographs, from and to, degrees."""
    side_overlap: float
    """At the canopy, 0..1."""
    source: str
    """Where the figures come from."""


TARGETS: dict[str, Target] = {
    "conifer": Target(
        (0.15, 0.20), (5.0, 8.0), 0.4, "thesis 4.1.2 and 4.1.3: 15-20 cm, 5-10 degrees; findings T15, T16"
    ),
    "broadleaf": Target(
        (0.15, 0.20), (4.0, 6.0), 0.6, "thesis 4.1: leaves move and hide more than needles; T06, T17"
    ),
    "reed": Target((0.10, 0.16), (4.0, 8.0), 0.3, "reed paper 2.3: 14 cm, 80 % forward; T02, R09"),
    "orthophoto": Target(
        (0.02, 0.10), (5.0, 12.0), 0.7, "orthomosaic paper 2.2: 2.6 cm, 90 % forward, 75 % side"
    ),
}
USABLE_OVERLAP = 0.5
"""Below, a place of the canopy is not seen by two neighbouring pairs of a strip."""
STEEPEST_ANGLE = 10.0
"""Beyond, the unmatched share in trees jumps [thesis 4.1.3, finding T06], degrees."""
FINEST_MATCH = 0.10
"""Canopy is matched badly below this ground resolution [thesis 4.1.2]: match at a coarser downscale, m."""


@dataclass(frozen=True, eq=False)
class Advice:
    """What to fly."""

    camera: str
    """Virtual camera that the geometry is of."""
    purpose: str
    """conifer, broadleaf, reed or orthophoto."""
    stand_height: float
    """Height of the canopy above ground, m."""
    height: float
    """Of the flight above ground, m."""
    gsd_canopy: float
    """Ground resolution at the canopy, m."""
    gsd_ground: float
    """On the ground, m."""
    downscale: int
    """Match photographs reduced by this factor, so that the canopy has the resolution of the target."""
    angle_canopy: float
    """Intersection angle at the canopy, degrees."""
    angle_ground: float
    """On the ground, degrees."""
    forward_overlap: float
    """To set in a planner that refers to the ground, 0..1."""
    forward_overlap_canopy: float
    """What is left of it at the canopy, 0..1."""
    side_overlap: float
    """To set for the ground, 0..1."""
    unmatched: dict[str, tuple[float, float]]
    """Share of the canopy without a match, from and to, per cent, by the published table and by our virtual
    flights; empty where nothing was measured (reed, orthophoto)."""
    evidence: tuple[str, ...]
    """What the advice rests on, and how far it carries."""

    def __str__(self) -> str:
        text = (
            f"{self.camera}, {self.purpose}, canopy at {self.stand_height:g} m: fly {self.height:.0f} m "
            f"above ground (GSD {100 * self.gsd_ground:.1f} cm, {100 * self.gsd_canopy:.1f} cm at the "
            f"canopy, match at downscale {self.downscale}), "
            f"forward overlap {100 * self.forward_overlap:.0f} % "
            f"({100 * self.forward_overlap_canopy:.0f} % at the canopy), "
            f"side {100 * self.side_overlap:.0f} %, angle {self.angle_canopy:.1f} degrees at the canopy."
        )
        for source, (low, high) in self.unmatched.items():
            text += f" Unmatched canopy, {source}: {low:.1f}-{high:.1f} %."
        return text + "\n" + "\n".join(f"- {line}" for line in self.evidence)


@dataclass(frozen=True, eq=False)
class Measurable:
    """What a set of photographs can measure, by height above ground."""

    site: str
    """Name of the site."""
    levels: pd.DataFrame
    """Per height: height_m, forward_overlap, side_overlap, angle_deg, gsd_m, pixels_per_metre, verdict."""

    def __str__(self) -> str:
        lines = [
            f"{row['height_m']:g} m above ground: overlap {100 * row['forward_overlap']:.0f} %, angle "
            f"{row['angle_deg']:.0f} degrees, GSD {100 * row['gsd_m']:.1f} cm: {row['verdict']}"
            for row in self.levels.to_dict("records")
        ]
        return f"{self.site}\n" + "\n".join(lines)

    def _repr_html_(self) -> str:
        return str(self.levels.round(3).to_html(index=False))


def advise(
    camera: str,
    stand_height: float,
    purpose: Purpose,
    *,
    highest: float | None = None,
    root: Path = Path(),
) -> Advice:
    """Overlap, ground resolution and angle to fly, all at the height of the canopy.

    The resolution is the middle of what the purpose asks for, the angle the middle of its range; the base
    follows from the angle, the overlaps from the base. Where the flight may not go that high, it stays at the
    limit and the photographs are reduced for matching.

    Parameters
    ----------
    camera
        One of :func:`workbench.virtual.flight_cameras.flight_camera_names`.
    stand_height
        Height of the canopy above ground, m; 0 for open ground.
    purpose
        What is to be measured.
    highest
        Limit of the flying height above ground, m; none by default.
    root
        Folder with ``data/published`` and the tables of the studies.

    Raises
    ------
    SceneError
        If the camera is unknown.
    StudyError
        If the purpose is unknown, or the limit is not above the canopy.
    """
    if purpose not in TARGETS:
        raise StudyError(f"No advice for {purpose!r}: choose from {', '.join(TARGETS)}.")
    if stand_height < 0 or (highest is not None and highest <= stand_height):
        raise StudyError(f"A canopy at {stand_height} m and a limit of {highest} m leave nothing to fly.")
    target, optics = TARGETS[purpose], flight_camera(camera)
    scale = optics.pixel_size / optics.focal_length
    gsd = sum(target.gsd) / 2
    height = gsd / scale + stand_height
    if highest is not None:
        height = min(height, highest)
    above = height - stand_height
    angle = sum(target.angle) / 2
    base = above * math.tan(math.radians(angle))
    along, across = optics.full_frame[1] * scale, optics.full_frame[0] * scale
    spacing = (1 - target.side_overlap) * across * above
    own = above * scale
    downscale = max(round(gsd / own), 1)
    return Advice(
        camera,
        purpose,
        stand_height,
        height,
        own,
        height * scale,
        downscale,
        angle,
        math.degrees(math.atan(base / height)),
        1 - base / (along * height),
        1 - base / (along * above),
        1 - spacing / (across * height),
        _unmatched(root, angle, own * downscale) if purpose in ("conifer", "broadleaf") else {},
        _evidence(root, target, purpose),
    )


def what_can_be_measured(
    site: Site, *, heights: tuple[float, ...] = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
) -> Measurable:
    """Overlap, angle and resolution of given photographs at heights above ground, and what follows.

    From recorded positions; overlap and angle are those of neighbours in a strip at a plane of that height.

    Parameters
    ----------
    site
        Any site with positions.
    heights
        Above ground, m; those above the cameras are left out.

    Raises
    ------
    SiteError
        If positions, cameras or the height of the ground are unknown.
    """
    ground, _ = ground_height(site)
    placed = [p for p in site.photographs if p.position is not None and p.camera in site.cameras]
    strips = pd.DataFrame(
        [(p.strip, p.order, *p.position, site.cameras[p.camera].focal_x) for p in placed if p.position],
        columns=["strip", "order", "x", "y", "z", "focal"],
    ).sort_values(["strip", "order"])
    steps = strips.groupby("strip")[["x", "y"]].diff().dropna().to_numpy()
    base = float(np.median(np.hypot(*steps.T))) if len(steps) else float("nan")
    camera_height = float(strips["z"].median()) - ground
    focal = float(strips["focal"].median())
    rows = []
    for height in heights:
        above = camera_height - height
        if above <= 1.0:
            continue
        overlap = overlap_map(site, ground=ground + height)
        angle = math.degrees(math.atan(base / above))
        gsd = above / focal
        rows.append(
            {
                "height_m": height,
                "forward_overlap": overlap.forward,
                "side_overlap": overlap.across,
                "angle_deg": angle,
                "gsd_m": gsd,
                "pixels_per_metre": base / above / gsd,
                "verdict": _judge(overlap.forward, angle, gsd),
            }
        )
    return Measurable(site.name, pd.DataFrame(rows))


def unmatched_lines(root: Path = Path()) -> dict[str, Collapse]:
    """Lines through unmatched shares: Table 4.1, and the tree cells of study ``angle-gsd`` if it ran."""
    table = pd.read_csv(Path(root) / "data" / "published" / "tree_table4_01_unmatched_gsd.csv")
    angles = table["overlap_pct"].map({90: 2.65, 80: 5.3, 70: 7.9, 60: 10.5})
    lines = {
        "published": disparity_collapse(
            table["gsd_cm"].to_numpy(), angles.to_numpy(), table["count_zero_pct"].to_numpy()
        )
    }
    for name in ("angle-gsd", "angle-gsd-quick"):
        path = Path(root) / "data" / "studies" / name / "table.csv"
        study = pd.read_csv(path) if path.exists() else None
        if study is not None and "count_0_mask" in set(study["response"]):
            lines["virtual"] = study_collapse(study, "count_0_mask")
            break
    return lines


def study_collapse(table: pd.DataFrame, response: str) -> Collapse:
    """Collapse of the means over seeds of a study with factors ``gsd_cm`` and ``thin``."""
    share, angle = (means(table, name)[["gsd_cm", "thin", "mean"]] for name in (response, "angle"))
    merged = share.merge(angle, on=["gsd_cm", "thin"], suffixes=("", "_angle"))
    return disparity_collapse(
        merged["gsd_cm"].to_numpy(float), merged["mean_angle"].to_numpy(), merged["mean"].to_numpy()
    )


def _unmatched(root: Path, angle: float, gsd: float) -> dict[str, tuple[float, float]]:
    """What each line expects, plus and minus its scatter (one standard deviation), per cent."""
    logs = math.log(math.tan(math.radians(angle)) / gsd)
    found = {}
    for name, line in unmatched_lines(root).items():
        scatter = float(line.cells["residual"].std(ddof=2))
        logit = line.intercept + line.slope * logs
        low, high = (100 / (1 + math.exp(-logit - sign * scatter)) for sign in (-1, 1))
        found[name] = (low, high)
    return found


def _evidence(root: Path, target: Target, purpose: str) -> tuple[str, ...]:
    low, high = (100 * value for value in target.gsd)
    lines = [
        f"target: {low:g}-{high:g} cm and {target.angle[0]:g}-{target.angle[1]:g} degrees at the canopy "
        f"({target.source})"
    ]
    path = Path(root) / TABLE
    asked = {"conifer": ("T02", "T03", "T15", "T16"), "broadleaf": ("T06", "T08", "T15", "T16")}
    if path.exists():
        table = pd.read_csv(path).set_index("id")
        for number in asked.get(purpose, ()):
            row = table.loc[number]
            lines.append(f"{number} {row['verdict']} on virtual flights: {row['finding']}")
    for name, line in unmatched_lines(root).items() if purpose in asked else ():
        spread = float(line.cells["residual"].std(ddof=2))
        lines.append(
            f"unmatched share, {name}: logit {line.intercept:.2f} + {line.slope:.2f} ln(px per m), scatter "
            f"{spread:.2f} logits ({len(line.cells)} cells)"
        )
    if purpose == "broadleaf":
        lines.append("the lines are of conifer stands: for broadleaf read them as a lower bound")
    return tuple(lines)


def _judge(overlap: float, angle: float, gsd: float) -> str:
    if not overlap > 0:
        return "not seen by two photographs of a strip: nothing"
    if overlap < USABLE_OVERLAP:
        text = "seen by one pair of a strip at most; heights cannot be checked by a second pair"
        return text + ("; canopy hardly matches at this angle" if angle > STEEPEST_ANGLE else "")
    if angle > STEEPEST_ANGLE:
        return "open ground, roofs and single hard objects; canopy leaves large holes at this angle"
    if gsd < FINEST_MATCH:
        return f"ground and objects; canopy when matched at downscale {math.ceil(FINEST_MATCH / gsd)} or more"
    return "ground, objects and canopy"
