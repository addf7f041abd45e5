"""A drone block fixed by control points alone, as good and as bad as people measure them.

    python benchmarks/control_points.py --root DIR [--noise 1.5]

Simulates `benchmarks/scenes/control.yaml` (42 photographs, GSD 8 cm, relief of 6 m) and forgets all recorded
positions. Five of ten points are control, five check; their places in the photographs carry the error of
someone who clicks (``--noise`` px). Then the same with what goes wrong: one point off by metres or
decimetres, a mistyped measurement, swapped axes, points on a line, three points, recorded heights in another
datum. What `workbench check` finds makes `workbench orient` refuse; here it is adjusted all the same, to see
what the adjustment alone would say. Errors of the check points are against their true places.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap

from workbench.errors import WorkbenchError
from workbench.orientation.control import PointResidual
from workbench.orientation.features import match_features
from workbench.orientation.georeference import Georeference, georeference
from workbench.orientation.mapping import map_block
from workbench.params import OrientParameters, Parameters
from workbench.site import ControlPoint, Site, check_site, load_site
from workbench.site.model import Role
from workbench.site.tables import read_table
from workbench.virtual import simulate_scene

SCENE = Path(__file__).parent / "scenes" / "control.yaml"
CONTROL = ("P01", "P05", "P08", "P16", "P20")
CHECK = ("P03", "P06", "P12", "P14", "P18")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--noise", type=float, default=1.5)
    options = parser.parse_args()
    site = clicked(ten_points(options.root), options.noise)
    placed = site
    site = replace(site, photographs=tuple(replace(p, position=None) for p in site.photographs))
    parameters, first = OrientParameters(), site.control[0]
    offset = np.array([round(first.x, -2), round(first.y, -2), 0.0])
    folder = options.root / "work"
    database = match_features(site, parameters, folder)
    free, models = map_block(site, database, offset, parameters, folder)
    print(
        f"without positions: {free.num_reg_images()} of {len(site.photographs)}, {models} model(s)",
        flush=True,
    )
    rows = [tried(name, free, spoiled, offset, parameters) for name, spoiled in cases(site).items()]
    with_positions, _ = map_block(placed, database, offset, parameters, folder)
    rows += [
        tried(f"{name}, with positions", with_positions, spoiled, offset, parameters)
        for name, spoiled in cases(placed).items()
    ]
    for count in (1, 5):
        named = set(CONTROL[-count:])
        fewer = with_control(ellipsoidal(placed), lambda p, named=named: as_control(p, named))
        risen, _ = map_block(fewer, database, offset, parameters, folder)
        name = f"recorded heights 45 m too high, {count} control point(s)"
        rows.append(tried(name, risen, fewer, offset, parameters))
    print(pd.DataFrame(rows).to_string(index=False, float_format=lambda v: f"{v:.3f}"))


def ten_points(root: Path) -> Site:
    """The site, simulated once, with the roles of this experiment."""
    if not (root / "data" / "sites" / "control" / "site.yaml").exists():
        simulate_scene(SCENE, root, Parameters())
    site = load_site("control", root)
    roles: dict[str, Role] = dict.fromkeys(CONTROL, "control")
    roles |= dict.fromkeys(CHECK, "check")
    points = tuple(replace(p, role=roles[p.name]) for p in site.control if p.name in roles)
    seen = tuple(o for o in site.observations if o.name in roles)
    return replace(site, control=points, observations=seen)


def clicked(site: Site, noise: float) -> Site:
    """Measurements with a normal error, px."""
    random = np.random.default_rng(1)
    off = random.normal(0, noise, (len(site.observations), 2))
    seen = tuple(
        replace(o, column=o.column + float(dc), row=o.row + float(dr))
        for o, (dc, dr) in zip(site.observations, off, strict=True)
    )
    return replace(site, observations=seen)


def cases(site: Site) -> dict[str, Site]:
    """What may be wrong with the control points of a site."""
    first = next(k for k, o in enumerate(site.observations) if o.name == "P08")
    mistyped = list(site.observations)
    mistyped[first] = replace(mistyped[first], column=site.cameras["camera1"].width - mistyped[first].column)
    on_a_line = {"P01", "P03", "P05"}  # Along the southern edge.
    return {
        "as measured": site,
        "one point 5 m off": moved(site, "P05", (3.0, -4.0, 0.0)),
        "one point 1 m too high": moved(site, "P08", (0.0, 0.0, 1.0)),
        "one point 0.4 m off": moved(site, "P16", (0.4, 0.0, 0.0)),
        "one measurement mistyped": replace(site, observations=tuple(mistyped)),
        "one point with swapped axes": with_control(
            site, lambda p: replace(p, x=p.y, y=p.x) if p.name == "P05" else p
        ),
        "all axes swapped": with_control(site, lambda p: replace(p, x=p.y, y=p.x)),
        "three points": with_control(
            site, lambda p: replace(p, role="control" if p.name in CONTROL[:3] else "check")
        ),
        "points on a line": with_control(
            site, lambda p: replace(p, role="control" if p.name in on_a_line else "check")
        ),
        "all points control": with_control(site, lambda p: replace(p, role="control")),
    }


def ellipsoidal(site: Site) -> Site:
    """Recorded heights above the ellipsoid, where the survey's are above the geoid."""
    photographs = tuple(
        replace(p, position=(p.position[0], p.position[1], p.position[2] + 45.0)) if p.position else p
        for p in site.photographs
    )
    return replace(site, photographs=photographs)


def as_control(point: ControlPoint, names: set[str]) -> ControlPoint:
    return replace(point, role="control" if point.name in names else "check")


def with_control(site: Site, change) -> Site:
    return replace(site, control=tuple(change(point) for point in site.control))


def moved(site: Site, name: str, by: tuple[float, float, float]) -> Site:
    dx, dy, dz = by

    def change(point: ControlPoint) -> ControlPoint:
        if point.name != name:
            return point
        return replace(point, x=point.x + dx, y=point.y + dy, z=point.z + dz)

    return with_control(site, change)


def tried(
    name: str, free: pycolmap.Reconstruction, site: Site, offset: np.ndarray, parameters: OrientParameters
) -> dict[str, object]:
    """What `workbench check` and the adjustment say, and the true errors of the check points."""
    model = pycolmap.Reconstruction(free)
    errors = check_site(site).errors
    row: dict[str, object] = {"case": name, "check says": errors[0].text if errors else "-"}
    try:
        fixed = georeference(model, site, offset, parameters)
    except WorkbenchError as error:
        return row | {"adjustment says": str(error)[:90]}
    rows = fixed.residuals(model)
    horizontal, vertical = true_errors(site, rows, set(CHECK))
    control = [r for r in rows if r.role == "control"]
    return row | {
        "adjustment says": _said(fixed),
        "control_xy_m": float(np.sqrt(np.mean([r.dx**2 + r.dy**2 for r in control]))),
        "control_z_m": float(np.sqrt(np.mean([r.dz**2 for r in control]))),
        "true_xy_m": horizontal,
        "true_z_m": vertical,
    }


def _said(fixed: Georeference) -> str:
    if fixed.misread:
        return f"measurement in {fixed.misread[0].photo} off by {fixed.misread[0].miss_px:.0f} px, left out"
    if fixed.gross:
        return f"left out: {', '.join(fixed.gross)}"
    if fixed.placing.shift.any():
        return f"positions {fixed.placing.shift[2]:+.1f} m in height"
    if fixed.placing.on_a_line:
        return "on a line, positions hold the block"
    return f"fits badly: {fixed.doubtful}" if fixed.doubtful else "-"


def true_errors(site: Site, rows: list[PointResidual], names: set[str]) -> tuple[float, float]:
    """Root mean squares of estimated minus true coordinates of some points, metres."""
    truth = {
        row["name"]: np.array([float(row[axis]) for axis in "xyz"])
        for _, row in read_table(site.folder / "truth" / "targets.csv", ["name", "x", "y", "z"])
    }
    surveyed = {p.name: np.array([p.x, p.y, p.z]) for p in site.control}
    off = np.array([surveyed[r.name] + (r.dx, r.dy, r.dz) - truth[r.name] for r in rows if r.name in names])
    return float(np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())), float(np.sqrt((off[:, 2] ** 2).mean()))


if __name__ == "__main__":
    main()
