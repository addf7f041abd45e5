"""Rules of the findings of the orthomosaic paper."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage

from workbench.rasters import Grid, match_grid, read_raster
from workbench.site import load_site
from workbench.site.files import write_text
from workbench.site.tables import read_table
from workbench.studies.findings import Criterion, Evidence, NotTestable, rule
from workbench.studies.reproducibility import NOT_COMPARED

_SITE, _OVERCAST = "low_sun", "cloudy"
"""Virtual sites whose chain is repeated: scene ``clearing`` in clear and in overcast light."""
_GAP_WITHIN = 2.0
"""Forest nearer than this to open ground or dead trees is at a gap, m."""


@rule(
    "O01",
    "the smallest check point error lies at neither the loosest nor the strictest threshold (in more than "
    "half of the seeds)",
    "best at 0.4 px in the forest flights, worse at 0.1",
)
def o01(e: Evidence) -> Iterator[Criterion]:
    errors = _by_threshold(e)
    best = np.nanargmin(errors.to_numpy(), axis=1)
    interior = (best > 0) & (best < errors.shape[1] - 1)
    yield Criterion("share of seeds with an interior optimum", interior.astype(float), ">", 0.5)


@rule(
    "O02",
    "horizontal check point error at the loosest threshold over that at the best: above 10",
    "from about 3 m to 0.02-0.06 m",
)
def o02(e: Evidence) -> Iterator[Criterion]:
    errors = _by_threshold(e, "check_xy")
    yield Criterion("error before over after", errors.iloc[:, 0] / errors.min(axis=1), ">", 10.0)


@rule(
    "O03",
    "vertical over horizontal check point error above 1 and at most 6",
    "1.6 to 5.3 in the forest flights",
)
def o03(e: Evidence) -> Iterator[Criterion]:
    errors = _repetitions(e)
    ratio = errors["check_rms_z_m"] / errors["check_rms_xy_m"]
    yield Criterion("vertical over horizontal", ratio, ">", 1.0)
    yield Criterion("vertical over horizontal", ratio, "<=", 6.0)


@rule(
    "O04",
    "standard deviation of the check point error over repetitions below 1 cm horizontally, 3 cm vertically",
    "at most 0.53 cm and 2.23 cm in the forest flights",
)
def o04(e: Evidence) -> Iterator[Criterion]:
    errors = _repetitions(e)
    for axis, limit in (("xy", 1.0), ("z", 3.0)):
        spread = 100 * errors[f"check_rms_{axis}_m"].std(ddof=1)
        yield Criterion(f"standard deviation {axis}", np.array([spread]), "<", limit, "cm")


@rule(
    "O05",
    "at least 95 % of meadow reproducible, forest between 60 and 90 %",
    "99 % of grassland, 75 % of forest",
)
def o05(e: Evidence) -> Iterator[Criterion]:
    forest = _share(e, "dsm", "forest")
    yield Criterion("meadow", _share(e, "dsm", "meadow"), ">=", 95.0, "%")
    yield Criterion("forest", forest, ">", 60.0, "%")
    yield Criterion("forest", forest, "<", 90.0, "%")


@rule("O06", "share of forest reproducible higher on the mesh than on the DSM", "74 against 69 %")
def o06(e: Evidence) -> Iterator[Criterion]:
    difference = _share(e, "mesh", "forest") - _share(e, "dsm", "forest")
    yield Criterion("forest, mesh minus DSM", difference, ">", 0.0, "points")


@rule(
    "O07",
    "non-reproducible masks of the first 5 of at least 10 repetitions and of all: Jaccard index above 0.7",
    "5 repetitions (10 pairs) against 25 (300 pairs)",
)
def o07(e: Evidence) -> Iterator[Criterion]:
    if len(_repetitions(e)) < 10:
        raise NotTestable(
            f"only {len(_repetitions(e))} repetitions of {_SITE} were run; ten cost about half an hour: "
            "`workbench study reproducibility`"
        )
    path = _folder(e.root, _SITE) / "subset_agreement.csv"
    if not path.exists():
        raise NotTestable(f"{path.name} is missing: the masks of the first five have not been compared")
    yield Criterion("Jaccard index", pd.read_csv(path)["jaccard"].to_numpy(), ">", 0.7)


@rule(
    "O08",
    f"share of forest that is not reproducible within {_GAP_WITHIN:g} m of open ground or dead trees over "
    "that farther away: above 1.2",
    "stated in words and maps",
)
def o08(e: Evidence) -> Iterator[Criterion]:
    gaps = gap_shares(e.root)
    if not gaps["far"] > 0:
        raise NotTestable("the forest of the site is too small to tell gaps from its interior")
    yield Criterion("share at gaps over share elsewhere", np.array([gaps["near"] / gaps["far"]]), ">", 1.2)


def gap_shares(root: Path, site: str = _SITE) -> dict[str, float]:
    """Share of forest that is not reproducible near gaps and farther away, 0..1.

    From the layer of the repetitions and the truth of the site; where they are not there, from ``gaps.csv``
    beside them, which this writes.

    Raises
    ------
    NotTestable
        If neither is there.
    """
    folder = _folder(Path(root), site)
    path, noted = folder / "reproducibility_dsm.tif", folder / "gaps.csv"
    if not path.exists():
        if noted.exists():
            return {row["place"]: float(row["share"]) for row in pd.read_csv(noted).to_dict("records")}
        raise NotTestable(_how_to_repeat(site))
    layer = read_raster(path)
    grid = Grid.of(layer)
    truth = load_site(folder.name, root).truth
    if truth is None:
        raise NotTestable(f"site {site} has no true land cover")
    cover = match_grid(read_raster(truth / "cover.tif"), grid, resampling="nearest").to_numpy()
    code = {row["cover"]: int(row["code"]) for _, row in read_table(truth / "cover.csv", ["code", "cover"])}
    forest = np.isin(cover, [code[name] for name in ("broadleaf", "conifer", "forest_floor")])
    distance = ndimage.distance_transform_edt(forest, sampling=grid.resolution)
    compared = forest & (layer.to_numpy() != NOT_COMPARED)
    runs = len(pd.read_csv(folder / "errors.csv"))
    different = layer.to_numpy() < runs * (runs - 1) // 2
    shares = {
        name: float(different[cells].mean()) if cells.any() else math.nan
        for name, cells in (
            ("near", compared & (distance <= _GAP_WITHIN)),
            ("far", compared & (distance > _GAP_WITHIN)),
        )
    }
    text = pd.DataFrame(shares.items(), columns=["place", "share"]).to_csv(index=False, lineterminator="\n")
    write_text(text, noted)
    return shares


@rule(
    "O09",
    "mean shift of objects between dates below 0.1 m on open ground and between 0.1 and 0.6 m in the canopy",
    "0.03 m (at most 0.07) and 0.3 m (at most 0.75)",
)
def o09(e: Evidence) -> Iterator[Criterion]:
    path = e.root / "data" / "studies" / "time-series" / "shifts.csv"
    if not path.exists():
        raise NotTestable(
            "no virtual series with digitised objects was flown: the shifts "
            "(workbench.studies.object_shifts) need boxes that someone drew on every date"
        )
    shifts = pd.read_csv(path).groupby("place")["shift_m"].mean()
    yield Criterion("open ground", np.array([shifts["open"]]), "<", 0.1, "m")
    yield Criterion("canopy", np.array([shifts["canopy"]]), ">", 0.1, "m")
    yield Criterion("canopy", np.array([shifts["canopy"]]), "<", 0.6, "m")


@rule(
    "O10",
    "share of forest reproducible under an overcast sky above that in low sun",
    "stated in words",
)
def o10(e: Evidence) -> Iterator[Criterion]:
    # Both lights from one preset: a coarser flight is another difference.
    names: tuple[str, ...] = (_OVERCAST, _SITE)
    if not all(_is_whole(e.root, name) for name in names):
        names = tuple(f"{name}-quick" for name in names)
    overcast, low_sun = (_share(e, "dsm", "forest", name) for name in names)
    yield Criterion("forest, overcast minus low sun", overcast - low_sun, ">", 0.0, "points")


def _by_threshold(e: Evidence, what: str = "check") -> pd.DataFrame:
    """Check point error (m): a row per seed, a column per threshold, loosest first."""
    names = e.table("tie-points")["response"].unique()
    thresholds = sorted((float(n.split("@")[1]) for n in names if n.startswith("check_xy@")), reverse=True)
    if what == "check":
        both = [(e.values("tie-points", f"check_{axis}@{t:g}") for axis in ("xy", "z")) for t in thresholds]
        columns = [(xy**2 + z**2) ** 0.5 for xy, z in both]
    else:
        columns = [e.values("tie-points", f"{what}@{t:g}") for t in thresholds]
    return pd.concat(columns, axis=1, keys=thresholds)


def _repetitions(e: Evidence, site: str = _SITE) -> pd.DataFrame:
    path = _folder(e.root, site) / "errors.csv"
    if not path.exists():
        raise NotTestable(_how_to_repeat(site))
    return pd.read_csv(path)


def _share(e: Evidence, surface: str, cover: str, site: str = _SITE) -> np.ndarray:
    """Per cent of a land cover that is reproducible in all pairs."""
    path = _folder(e.root, site) / "reproducibility.csv"
    if not path.exists():
        raise NotTestable(_how_to_repeat(site))
    table = pd.read_csv(path)
    row = table[(table["surface"] == surface) & (table["cover"] == cover)]
    return np.array([100 * float(row["share"].iloc[0]) if len(row) else math.nan])


def _folder(root: Path, site: str) -> Path:
    """Repetitions of a site; those of the quick preset where the whole study has not been run."""
    parent = root / "data" / "studies" / "reproducibility"
    quick = parent / f"{site}-quick"
    return quick if quick.is_dir() and not _is_whole(root, site) else parent / site


def _is_whole(root: Path, site: str) -> bool:
    return (root / "data" / "studies" / "reproducibility" / site / "errors.csv").exists()


def _how_to_repeat(site: str = _SITE) -> str:
    return f"the chain of site {site} was not repeated: `workbench study reproducibility` does so"


RULES = (o01, o02, o03, o04, o05, o06, o07, o08, o09, o10)
