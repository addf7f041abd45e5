"""Repetitions of the chain with other seeds, and how alike their mosaics are [orthomosaic paper 2.5-2.7]."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import xarray as xr

from workbench.environment import describe_environment
from workbench.errors import StudyError
from workbench.matching import match_site
from workbench.mosaic.stage import mosaic_site
from workbench.orientation import orient_site
from workbench.params import Parameters
from workbench.rasters import Grid, match_grid, read_raster, write_raster
from workbench.site import Site
from workbench.site.tables import read_table
from workbench.stages import FOLDERS, read_json, write_json
from workbench.studies.reproducibility import Reproducibility, reproducibility
from workbench.surface import surface_site

Surface = Literal["dsm", "mesh"]
_TREES = ("broadleaf", "conifer", "dead_tree", "forest_floor")


@dataclass(frozen=True, eq=False)
class Repetitions:
    """Mosaics of the same photographs with different seeds, compared in all pairs."""

    folder: Path
    """Where repetitions, layers and tables are kept."""
    by_surface: dict[str, Reproducibility]
    """Agreement of the mosaics made with each surface."""
    table: pd.DataFrame
    """surface, cover, pixels, share (reproducible in all pairs)."""
    errors: pd.DataFrame
    """Per repetition: seed and the errors of control and check points, metres."""

    def _repr_html_(self) -> str:
        return self.table.to_html(index=False) + self.errors.to_html(index=False)


def repeat_chain(
    site: Site,
    parameters: Parameters,
    *,
    repetitions: int | None = None,
    surfaces: Sequence[Surface] = ("dsm", "mesh"),
    folder: Path | None = None,
    announce: Callable[[str], None] = print,
) -> Repetitions:
    """Run the chain several times with other seeds, and compare the mosaics pixel by pixel.

    Every repetition orients, matches, makes the surface and a mosaic on each of ``surfaces``. It is kept
    in a folder of its own; one that is complete is not computed again, so that an interrupted study
    continues, and more repetitions are added to those that exist. Of a repetition the mosaics and the
    metrics are kept, not the disparities.

    Parameters
    ----------
    site
        The site; its own products are not touched.
    parameters
        ``orient.seed`` is that of the first repetition; the next ones count up.
    repetitions
        Number of runs, at least 2; None takes ``study.repetitions``.
    surfaces
        Surfaces for the mosaics.
    folder
        None: ``data/studies/reproducibility/<site>`` below the root.

    Returns
    -------
    Repetitions
        Also written: ``reproducibility_<surface>.tif``, ``reproducibility.csv``, ``errors.csv``,
        ``environment.json``.

    Raises
    ------
    StudyError
        If fewer than two repetitions are asked for, or their mosaics have no common area.
    """
    count = parameters.study.repetitions if repetitions is None else repetitions
    if count < 2:
        raise StudyError(f"{count} repetition(s): reproducibility needs at least two.")
    folder = folder or site.root / "data" / "studies" / "reproducibility" / site.name
    folder.mkdir(parents=True, exist_ok=True)
    runs: list[Site] = []
    for number in range(count):
        announce(f"repetition {number + 1} of {count} ...")
        parameters = _with_cells_of(runs, parameters)
        runs.append(_repeat(site, parameters, parameters.orient.seed + number, folder, surfaces))
    by_surface: dict[str, Reproducibility] = {}
    tables = []
    for surface in surfaces:
        mosaics = _on_common_grid([read_raster(_mosaic(run, surface)) for run in runs])
        result = reproducibility(
            mosaics,
            window=parameters.study.correlation_window,
            threshold=parameters.study.identical_from,
            method=parameters.study.correlation_method,
        )
        write_raster(result.layer, folder / f"reproducibility_{surface}.tif")
        by_surface[surface] = result
        tables.append(_shares(result, site).assign(surface=surface))
    table = pd.concat(tables)[["surface", "cover", "pixels", "share"]]
    errors = _errors(runs)
    table.to_csv(folder / "reproducibility.csv", index=False, lineterminator="\n", float_format="%.6g")
    errors.to_csv(folder / "errors.csv", index=False, lineterminator="\n", float_format="%.6g")
    write_json(describe_environment(), folder / "environment.json")
    return Repetitions(folder, by_surface, table, errors)


def _repeat(site: Site, parameters: Parameters, seed: int, folder: Path, surfaces: Sequence[Surface]) -> Site:
    """One repetition, unless it is complete; a site whose products are those of the repetition."""
    seeded = parameters.model_copy(update={"orient": parameters.orient.model_copy(update={"seed": seed})})
    key = _key(site, seeded)
    run = replace(site, root=folder / f"seed_{seed:03d}")
    wanted = {surface: _mosaic(run, surface) for surface in surfaces}
    done = run.root / "repetition.json"
    if done.exists():
        noted = json.loads(done.read_text(encoding="utf-8"))
        if noted["key"] == key and all(path.exists() for path in wanted.values()):
            return run
        # Other parameters or photographs: what is there belongs to another study.
        shutil.rmtree(run.root)
    for stage in (orient_site, match_site, surface_site):
        stage(run, seeded)
    for surface, path in wanted.items():
        mosaic_site(
            run, seeded.model_copy(update={"mosaic": seeded.mosaic.model_copy(update={"surface": surface})})
        )
        (run.products / FOLDERS["mosaic"] / "ortho.tif").replace(path)
    shutil.rmtree(run.products / FOLDERS["match"])
    write_json({"key": key, "seed": seed}, done)
    return run


def _mosaic(run: Site, surface: str) -> Path:
    return run.products / f"ortho_{surface}.tif"


def _key(site: Site, parameters: Parameters) -> str:
    """Changes with everything that a repetition depends on: photographs and parameters of the chain."""
    sections = ("orient", "match", "surface", "mosaic")
    chain = {name: getattr(parameters, name).model_dump(mode="json") for name in sections}
    chain["mosaic"].pop("surface")
    photographs = [(p.name, p.path.stat().st_size) for p in site.photographs]
    text = json.dumps([site.name, str(site.crs), photographs, chain], sort_keys=True)
    return sha256(text.encode()).hexdigest()[:16]


def _with_cells_of(runs: Sequence[Site], parameters: Parameters) -> Parameters:
    """After the first repetition its cell sizes hold for all, however the later poses round."""
    if len(runs) != 1:
        return parameters
    surface = read_json(runs[0].products / FOLDERS["surface"] / "metrics.json")["cells_m"]
    mosaic = read_json(runs[0].products / FOLDERS["mosaic"] / "metrics.json")["resolution_m"]
    return parameters.model_copy(
        update={
            "surface": parameters.surface.model_copy(update={"resolution": surface}),
            "mosaic": parameters.mosaic.model_copy(update={"resolution": mosaic}),
        }
    )


def _on_common_grid(mosaics: Sequence[xr.DataArray]) -> list[xr.DataArray]:
    """The area that all mosaics have; their cells fall together, so nothing is resampled."""
    grids = [Grid.of(mosaic) for mosaic in mosaics]
    bounds = np.array([grid.bounds for grid in grids])
    west, south = bounds[:, :2].max(axis=0)
    east, north = bounds[:, 2:].min(axis=0)
    if west >= east or south >= north:
        raise StudyError("The mosaics of the repetitions have no common area: look at each of them.")
    common = []
    for mosaic, grid in zip(mosaics, grids, strict=True):
        rows = slice(*(round((grid.north - edge) / grid.resolution) for edge in (north, south)))
        columns = slice(*(round((edge - grid.west) / grid.resolution) for edge in (west, east)))
        common.append(mosaic.isel(y=rows, x=columns))
    return common


def _shares(result: Reproducibility, site: Site) -> pd.DataFrame:
    """By land cover where the truth tells it; the whole area otherwise."""
    if site.truth is None:
        return result.share_by(result.layer, {})
    grid = Grid.of(result.layer)
    cover = match_grid(read_raster(site.truth / "cover.tif"), grid, resampling="nearest")
    names = {
        int(row["code"]): row["cover"] for _, row in read_table(site.truth / "cover.csv", ["code", "cover"])
    }
    present = {code: name for code, name in names.items() if np.any(cover.values == code)}
    table = result.share_by(cover, present)
    forest = table[table["cover"].isin(_TREES)]
    return pd.concat([table, _together(forest, "forest")]) if len(forest) else table


def _together(rows: pd.DataFrame, name: str) -> pd.DataFrame:
    pixels = rows["pixels"].sum()
    share = (rows["share"] * rows["pixels"]).sum() / pixels if pixels else float("nan")
    return pd.DataFrame([{"cover": name, "pixels": pixels, "share": share}])


def _errors(runs: Sequence[Site]) -> pd.DataFrame:
    """Errors of control and check points of every repetition [orthomosaic paper, table 2]."""
    rows: list[Mapping[str, object]] = []
    for run in runs:
        metrics = read_json(run.products / FOLDERS["orient"] / "metrics.json")
        seed = json.loads((run.root / "repetition.json").read_text(encoding="utf-8"))["seed"]
        names = [f"{role}_rms_{axis}_m" for role in ("control", "check") for axis in ("xy", "z")]
        rows.append({"seed": seed, **{name: metrics[name] for name in names}})
    return pd.DataFrame(rows)
