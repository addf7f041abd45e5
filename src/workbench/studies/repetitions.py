"""Repetitions of the chain with other seeds, and how alike their mosaics are [orthomosaic paper 2.5-2.7]."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from workbench.studies.keys import hash_of, hash_of_code
from workbench.studies.repetition_pipeline import write_pipeline
from workbench.studies.reproducibility import Reproducibility, agreement, reproducibility
from workbench.surface import surface_site
from workbench.vectors import read_vector

SURFACES = ("dsm", "mesh")
"""Surfaces that mosaics can be compared on, as ``mosaic.surface`` names them."""
_FEW, _MANY = 5, 10
"""From so many repetitions on, the first few are compared with all."""
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
    surfaces: Sequence[str] = SURFACES,
    folder: Path | None = None,
    announce: Callable[[str], None] = print,
) -> Repetitions:
    """Run the chain several times with other seeds, and compare the mosaics pixel by pixel.

    Every repetition orients, matches, makes the surface and a mosaic on each of ``surfaces``, in a folder
    of its own. Each of these steps is kept, and computed again only if what it depends on has changed:
    photographs, its parameters, the step before, or the code. So an interrupted study continues, more
    repetitions or another surface are added to those that exist, and a changed parameter of the mosaic
    repeats the mosaics alone. Disparities are removed once the surface is made.

    Parameters
    ----------
    site
        The site; its own products are not touched.
    parameters
        ``orient.seed`` is that of the first repetition; the next ones count up.
    repetitions
        Number of runs, at least 2; None takes ``study.repetitions``.
    surfaces
        Surfaces for the mosaics, of :data:`SURFACES`.
    folder
        None: ``data/studies/reproducibility/<site>`` below the root.

    Returns
    -------
    Repetitions
        Also written: ``reproducibility_<surface>.tif``, ``reproducibility.csv``, ``histogram.csv``,
        ``errors.csv``, from ten repetitions on ``subset_agreement.csv`` (the first five against all),
        ``environment.json``, and ``dvc.yaml``, the same steps as stages of DVC.

    Raises
    ------
    StudyError
        If fewer than two repetitions are asked for, a surface is unknown, or the mosaics have no common
        area.
    """
    study = _Study(site, parameters, repetitions, surfaces, folder)
    study.folder.mkdir(parents=True, exist_ok=True)
    if folder is None:
        write_pipeline(site, parameters, study.seeds, surfaces, study.folder)
    for number, seed in enumerate(study.seeds, start=1):
        announce(f"repetition {number} of {len(study.seeds)} ...")
        study.run(seed)
    return study.compare()


def repeat_step(
    site: Site,
    parameters: Parameters,
    step: str,
    *,
    repetitions: int | None = None,
    surfaces: Sequence[str] = SURFACES,
    folder: Path | None = None,
) -> None:
    """One step of :func:`repeat_chain`, as a stage of DVC calls it.

    Parameters
    ----------
    step
        ``<seed>/orient``, ``<seed>/surface`` (with the matching before it), ``<seed>/mosaic_<surface>``, or
        ``compare``.

    Raises
    ------
    StudyError
        As :func:`repeat_chain`; and if there is no such step.
    """
    study = _Study(site, parameters, repetitions, surfaces, folder)
    steps = {f"{seed}/{name}": (seed, name) for seed in study.seeds for name in study.steps}
    if step == "compare":
        study.compare()
    elif step in steps:
        seed, name = steps[step]
        study.run(seed, until=name)
    else:
        raise StudyError(f"No step '{step}'; there are {', '.join([*steps, 'compare'])}.")


class _Study:
    """The repetitions of a site: where they are, and which of their steps are done."""

    def __init__(
        self,
        site: Site,
        parameters: Parameters,
        repetitions: int | None,
        surfaces: Sequence[str],
        folder: Path | None,
    ) -> None:
        count = parameters.study.repetitions if repetitions is None else repetitions
        if count < 2:
            raise StudyError(f"{count} repetition(s): reproducibility needs at least two.")
        unknown = sorted(set(surfaces) - set(SURFACES))
        if unknown or not surfaces:
            raise StudyError(f"Surfaces {unknown}: choose of {', '.join(SURFACES)}.")
        self.site, self.parameters, self.surfaces = site, parameters, surfaces
        self.folder = folder or site.root / "data" / "studies" / "reproducibility" / site.name
        first = parameters.orient.seed
        self.seeds = range(first, first + count)
        self.steps = ("orient", "surface", *(f"mosaic_{surface}" for surface in surfaces))

    def run(self, seed: int, until: str | None = None) -> Site:
        """Bring one repetition up to a step (all by default); a site whose products are its own."""
        run = self.repetition(seed)
        parameters = self._seeded(seed)
        before = _origin_key(self.site)
        for name in self.steps:
            done = run.root / "steps" / f"{name}.json"
            key = _step_key(name, parameters, before)
            if not _is_done(done, key):
                done.unlink(missing_ok=True)
                _compute(name, run, parameters)
                done.parent.mkdir(parents=True, exist_ok=True)
                write_json({"key": key, "seed": seed, "step": name}, done)
            if name in ("orient", "surface"):
                before = key
            if name == until:
                break
        return run

    def repetition(self, seed: int) -> Site:
        """The site with the products of one repetition."""
        return replace(self.site, root=self.folder / f"seed_{seed:03d}")

    def compare(self) -> Repetitions:
        """Compare the mosaics of all repetitions, and write what comes out."""
        runs = [self.repetition(seed) for seed in self.seeds]
        by_surface: dict[str, Reproducibility] = {}
        tables, histograms, subsets = [], [], []
        for surface in self.surfaces:
            result = self._agreement(runs, surface)
            if len(runs) >= _MANY:
                few = self._agreement(runs, surface, first=_FEW)
                subsets.append(_subset(surface, few, result, len(runs)))
            write_raster(result.layer, self.folder / f"reproducibility_{surface}.tif")
            by_surface[surface] = result
            tables.append(_shares(result, self.site).assign(surface=surface))
            histograms.append(result.histogram().assign(surface=surface))
        table = pd.concat(tables)[["surface", "cover", "pixels", "share"]]
        errors = _errors(runs, self.seeds)
        frames = {"reproducibility": table, "histogram": pd.concat(histograms), "errors": errors}
        if subsets:
            frames["subset_agreement"] = pd.DataFrame(subsets)
        for name, frame in frames.items():
            frame.to_csv(self.folder / f"{name}.csv", index=False, lineterminator="\n", float_format="%.6g")
        write_json(describe_environment(), self.folder / "environment.json")
        return Repetitions(self.folder, by_surface, table, errors)

    def _agreement(self, runs: Sequence[Site], surface: str, first: int | None = None) -> Reproducibility:
        """Agreement of the first repetitions on the area that all of them share."""
        study = self.parameters.study
        mosaics = common_area([read_raster(_mosaic(run, surface)) for run in runs])[:first]
        result = reproducibility(
            mosaics,
            window=study.correlation_window,
            threshold=study.identical_from,
            method=study.correlation_method,
        )
        if not study.crop:
            return result
        crops = [run.products / f"crop_{surface}.gpkg" for run in runs]
        return result.within([read_vector(path) for path in crops if path.exists()])

    def _seeded(self, seed: int) -> Parameters:
        """Parameters of a repetition; the cell sizes are those of the first, however later poses round."""
        updates: dict[str, Any] = {"orient": self.parameters.orient.model_copy(update={"seed": seed})}
        first = self.repetition(self.seeds[0]).products
        sizes = {
            "surface": (first / FOLDERS["surface"] / "metrics.json", "cells_m"),
            "mosaic": (first / f"mosaic_{self.surfaces[0]}.json", "resolution_m"),
        }
        for section, (path, name) in sizes.items():
            if seed != self.seeds[0] and path.exists():
                values = getattr(self.parameters, section)
                # Without the noise of float coordinates, so that the cells of all repetitions fall together.
                cell = round(read_json(path)[name], 9)
                updates[section] = values.model_copy(update={"resolution": cell})
        return self.parameters.model_copy(update=updates)


def _compute(name: str, run: Site, parameters: Parameters) -> None:
    if name == "orient":
        shutil.rmtree(run.products / FOLDERS["match"], ignore_errors=True)  # of other poses
        orient_site(run, parameters)
        shutil.rmtree(run.products / FOLDERS["orient"] / "work", ignore_errors=True)
    elif name == "surface":
        match_site(run, parameters)
        surface_site(run, parameters)
        shutil.rmtree(run.products / FOLDERS["match"])
    else:
        surface = name.removeprefix("mosaic_")
        mosaic = parameters.mosaic.model_copy(update={"surface": surface})
        mosaic_site(run, parameters.model_copy(update={"mosaic": mosaic}))
        folder = run.products / FOLDERS["mosaic"]
        for product, kept in (
            ("ortho.tif", f"ortho_{surface}.tif"),
            ("crop.gpkg", f"crop_{surface}.gpkg"),
            ("metrics.json", f"mosaic_{surface}.json"),
        ):
            if (folder / product).exists():
                (folder / product).replace(run.products / kept)
        shutil.rmtree(folder)


def _is_done(path: Path, key: str) -> bool:
    return path.exists() and json.loads(path.read_text(encoding="utf-8"))["key"] == key


def _mosaic(run: Site, surface: str) -> Path:
    return run.products / f"ortho_{surface}.tif"


def _origin_key(site: Site) -> str:
    """Changes with the photographs and what the site says of them."""
    photographs = [(p.name, p.path.stat().st_size, p.position) for p in site.photographs]
    terrain = site.dtm and (site.dtm.name, site.dtm.stat().st_size)
    known = [site.control, site.observations, sorted(site.cameras.items()), terrain]
    return hash_of([site.name, str(site.crs), photographs, repr(known)])


def _step_key(name: str, parameters: Parameters, before: str) -> str:
    sections = {"orient": ("orient",), "surface": ("match", "surface")}.get(name, ("mosaic",))
    packages = {"orient": ("orientation",), "surface": ("matching", "surface")}.get(name, ("mosaic",))
    values = {section: getattr(parameters, section).model_dump(mode="json") for section in sections}
    values.get("mosaic", {}).pop("surface", None)  # named by the step
    return hash_of([name, values, before, [hash_of_code(package) for package in packages]])


def common_area(mosaics: Sequence[xr.DataArray]) -> list[xr.DataArray]:
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
        part = mosaic.isel(y=rows, x=columns)
        # A part forgets what no data is; two empty cells would then count as identical.
        missing = mosaic.rio.nodata
        common.append(part if missing is None else part.rio.write_nodata(missing))
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


def _subset(surface: str, few: Reproducibility, many: Reproducibility, count: int) -> dict[str, object]:
    """Whether the first few repetitions find what all of them find [orthomosaic paper 3.2]."""
    found = agreement(few, many)
    start = {"surface": surface, "repetitions_few": _FEW, "repetitions": count}
    return {**start, "jaccard": found["overlap_any"], **found}


def _errors(runs: Sequence[Site], seeds: Sequence[int]) -> pd.DataFrame:
    """Errors of control and check points of every repetition [orthomosaic paper, table 2]."""
    rows: list[Mapping[str, object]] = []
    for run, seed in zip(runs, seeds, strict=True):
        metrics = read_json(run.products / FOLDERS["orient"] / "metrics.json")
        names = [f"{role}_rms_{axis}_m" for role in ("control", "check") for axis in ("xy", "z")]
        rows.append({"seed": seed, **{name: metrics[name] for name in names}})
    return pd.DataFrame(rows)
