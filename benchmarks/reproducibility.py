"""Reproducibility: speed of the local correlation, and what changes a mosaic beside the seed.

    python benchmarks/reproducibility.py speed
    python benchmarks/reproducibility.py sources --site S --root DIR

`sources` runs the chain of a site again with the same seed, but with other threads, tiles, order and names of
the photographs, and compares the mosaics with the first one: identical bytes, share of identical pixels,
share at a local correlation of 0.95.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import dask
import numpy as np
import pandas as pd

from workbench.matching import match_site
from workbench.mosaic import mosaic_site
from workbench.orientation import orient_site
from workbench.params import Parameters, load_parameters
from workbench.rasters import read_raster
from workbench.site import Site, load_site
from workbench.studies import local_correlation, reproducibility
from workbench.studies.repetitions import common_area
from workbench.surface import surface_site

Variant = Callable[[Site, Parameters, Path], tuple[Site, Parameters]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("speed", "sources"))
    parser.add_argument("--site")
    parser.add_argument("--root", type=Path, default=Path())
    options = parser.parse_args()
    if options.what == "speed":
        print(speed().to_string(index=False))
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
