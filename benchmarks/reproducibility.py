"""Reproducibility: speed of the local correlation, and what changes a mosaic beside the seed.

    python benchmarks/reproducibility.py speed
    python benchmarks/reproducibility.py sources --site S --root DIR
    python benchmarks/reproducibility.py series --root DIR

`sources` runs the chain of a site again with the same seed, but with other threads, tiles, order and names of
the photographs, and compares the mosaics with the first one: identical bytes, share of identical pixels,
share at a local correlation of 0.95.

`series` flies the virtual clearing on three dates of another wind, hour and GNSS error, runs the chain of
each, and measures how far objects shift between the mosaics: boulders and signals on the meadow, and the
middles of the visible crowns. They are followed by their pictures, where someone would draw boxes. Written to
DIR/data/studies/time-series/shifts.csv, which finding O09 reads.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import dask
import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio.features
import shapely

from workbench.matching import match_site
from workbench.mosaic import mosaic_site
from workbench.orientation import orient_site
from workbench.params import MosaicParameters, Parameters, load_parameters
from workbench.rasters import read_raster
from workbench.site import Site, load_site
from workbench.site.tables import read_table
from workbench.studies import follow_objects, local_correlation, object_shifts, reproducibility
from workbench.studies.repetitions import common_area
from workbench.surface import surface_site
from workbench.vectors import read_vector
from workbench.virtual import simulate_scene

Variant = Callable[[Site, Parameters, Path], tuple[Site, Parameters]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("speed", "sources", "series"))
    parser.add_argument("--site")
    parser.add_argument("--root", type=Path, default=Path())
    options = parser.parse_args()
    if options.what == "speed":
        print(speed().to_string(index=False))
        return
    if options.what == "series":
        print(series(options.root).to_string(float_format=lambda value: f"{value:.3f}"))
        return
    file = options.root / "params.yaml"
    parameters = load_parameters(file) if file.exists() else Parameters()
    table = sources(load_site(options.site, options.root), parameters, options.root / "sources")
    print(table.to_string(index=False))


def speed(rounds: int = 7) -> pd.DataFrame:
    """Seconds of CPU of the area of the paper, 600 x 650 pixels, best of several rounds."""
    random = np.random.default_rng(0)
    a = random.normal(100, 20, (600, 650))
    b = a + random.normal(0, 5, a.shape)
    rows = []
    for method in ("pearson", "spearman"):
        for window in (3, 5, 9):
            local_correlation(a[:50], b[:50], window, method)
            best = np.inf
            for _ in range(rounds):
                started = time.process_time()
                local_correlation(a, b, window, method)
                best = min(best, time.process_time() - started)
            rows.append({"method": method, "window": window, "seconds": round(best, 4)})
    return pd.DataFrame(rows)


def sources(site: Site, parameters: Parameters, folder: Path) -> pd.DataFrame:
    """One row a variant, compared with the plain run."""
    rows = []
    first: Path | None = None
    for name, vary in VARIANTS.items():
        home = folder / name.replace(" ", "_")
        shutil.rmtree(home, ignore_errors=True)
        varied, values = vary(replace(site, root=home), parameters, home)
        scheduler = "synchronous" if name == "dask without threads" else None
        with dask.config.set(scheduler=scheduler) if scheduler else dask.config.set({}):
            for stage in (orient_site, match_site, surface_site, mosaic_site):
                stage(varied, values)
        ortho = varied.products / "mosaic" / "ortho.tif"
        first = first or ortho
        a, b = common_area([read_raster(first), read_raster(ortho)])
        same = (a.values == b.values).all(axis=0)
        rows.append(
            {
                "variant": name,
                "same bytes": first.read_bytes() == ortho.read_bytes(),
                "identical pixels": round(float(same.mean()), 4),
                "r >= 0.95": round(reproducibility([a, b]).share, 4),
            }
        )
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def _plain(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    return site, parameters


def _threads(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    return site, _with(parameters, "orient", threads=1)


def _tiles(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    return site, _with(parameters, "surface", tile_size=256)


def _order(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    return replace(site, photographs=site.photographs[::-1]), parameters


def _names(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    """The same photographs under names whose order is the reverse."""
    photographs, new = [], {}
    folder = home / "renamed"
    folder.mkdir(parents=True)
    for place, photograph in enumerate(reversed(site.photographs)):
        new[photograph.name] = f"{place:04d}{photograph.path.suffix}"
        link = folder / new[photograph.name]
        link.symlink_to(photograph.path.resolve())
        photographs.append(replace(photograph, name=link.name, path=link))
    seen = tuple(replace(o, photo=new[o.photo]) for o in site.observations if o.photo in new)
    return replace(site, photographs=tuple(photographs), observations=seen), parameters


def _with(parameters: Parameters, section: str, **values: object) -> Parameters:
    return parameters.model_copy(
        update={section: getattr(parameters, section).model_copy(update=dict(values))}
    )


def _seed(site: Site, parameters: Parameters, home: Path) -> tuple[Site, Parameters]:
    return site, _with(parameters, "orient", seed=parameters.orient.seed + 1)


DATES = {
    "june": {"time": "2020-06-18T09:20:00+00:00", "wind": 2.0},
    "july": {"time": "2020-07-07T10:00:00+00:00", "wind": 3.0},
    "august": {"time": "2020-08-04T09:40:00+00:00", "wind": 4.0},
}
_CROWN, _OPEN = 1.2, 0.6  # Half an edge of the boxes, metres.
_FOUND = 0.5


def series(root: Path) -> pd.DataFrame:
    """Shifts of objects between the dates: number, mean, largest by place, metres."""
    scene = Path(str(files("workbench.studies") / "shipped" / "scenes" / "clearing.yaml"))
    mosaics, sites = {}, []
    for seed, (date, flight) in enumerate(DATES.items(), start=1):
        parameters = Parameters(mosaic=MosaicParameters(resolution=0.08))
        if not (root / "data" / "sites" / date / "site.yaml").exists():
            simulate_scene(
                scene, root, parameters, flight_overrides=flight | {"reduction": 8}, seed=seed, site_name=date
            )
        site = load_site(date, root)
        ortho = site.products / "mosaic" / "ortho.tif"
        if not ortho.exists():
            for stage in (orient_site, match_site, surface_site, mosaic_site):
                stage(site, parameters)
        sites.append(site)
        mosaics[date] = read_raster(ortho)
    common = dict(zip(mosaics, common_area(list(mosaics.values())), strict=True))
    tables = []
    for place, (boxes, search) in {
        "open": (_on_the_meadow(sites[0]), 0.4),
        "canopy": (_crowns(sites[0]), 1.2),
    }.items():
        first = next(iter(common))
        boxes = boxes.set_crs(sites[0].crs)
        dates = {first: boxes}
        for date in list(common)[1:]:
            dates[date] = follow_objects(
                boxes, common[first], common[date], search=search, least_score=_FOUND
            )
        tables.append(object_shifts(dates).table.assign(place=place))
    table = pd.concat(tables)
    folder = root / "data" / "studies" / "time-series"
    folder.mkdir(parents=True, exist_ok=True)
    table.drop(columns="geometry").to_csv(
        folder / "shifts.csv", index=False, lineterminator="\n", float_format="%.4f"
    )
    return table.groupby("place").shift_m.agg(["count", "median", "mean", "max"])


def _on_the_meadow(site: Site) -> gpd.GeoDataFrame:
    """Boxes around signals and boulders."""
    truth = site.truth or site.folder
    cover = read_raster(truth / "cover.tif")
    code = {row["cover"]: int(row["code"]) for _, row in read_table(truth / "cover.csv", ["code", "cover"])}
    stones = rasterio.features.shapes(
        (cover.values == code["boulder"]).astype(np.uint8), transform=cover.rio.transform()
    )
    places = [shapely.geometry.shape(shape).centroid for shape, value in stones if value == 1]
    places += [
        shapely.Point(float(row["x"]), float(row["y"]))
        for _, row in read_table(truth / "targets.csv", ["name", "x", "y"])
    ]
    return _boxes(places, _OPEN)


def _crowns(site: Site) -> gpd.GeoDataFrame:
    """Boxes around the middles of crowns that are seen from above."""
    trees = read_vector((site.truth or site.folder) / "trees.gpkg")
    seen = trees[trees.visible & ~trees.dead & ~trees.understorey]
    return _boxes(list(seen.geometry.centroid), _CROWN)


def _boxes(places: list, half: float) -> gpd.GeoDataFrame:
    boxes = [shapely.box(p.x - half, p.y - half, p.x + half, p.y + half) for p in places]
    return gpd.GeoDataFrame({"object": range(len(boxes))}, geometry=boxes)


VARIANTS: dict[str, Variant] = {
    "the same again": _plain,
    "once more": _plain,
    "one thread for features": _threads,
    "dask without threads": _plain,
    "tiles of 256 cells": _tiles,
    "list of photographs reversed": _order,
    "names in reverse order": _names,
    "another seed": _seed,
}


if __name__ == "__main__":
    main()
