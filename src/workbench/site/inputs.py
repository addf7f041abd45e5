"""What each stage reads of a site, as digests: so that DVC reruns a stage only when its own inputs change."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from workbench.errors import SiteError
from workbench.site.model import Site
from workbench.stages import write_json

_PLACE = ("crs", "vertical_datum")
_LIST, _SURVEY = "photographs.csv", ("control.csv", "observations.csv")

STATED: dict[str, tuple[str, ...]] = {
    "orient": (*_PLACE, "cameras", "unanswered"),
    "match": _PLACE,
    "surface": _PLACE,
    "mosaic": _PLACE,
    "reed": ("water_level",),
    "trees": (),
    "assess": (),
    "report": (),
}
"""Statements of ``site.yaml`` that each stage reads, by the names of :class:`workbench.site.Site`."""

NAMED: dict[str, tuple[str, ...]] = {
    "surface": ("dtm",),
    "reed": ("shoreline", "areas", "transects", "field_points", "plots", "reference_status"),
    "trees": ("shoreline",),
    "assess": ("reference_trees",),
}
"""Files that ``site.yaml`` names and each stage reads."""

BESIDE: dict[str, tuple[str, ...]] = {
    "orient": (_LIST, *_SURVEY),
    "match": (_LIST,),
    "surface": (_LIST,),
    "mosaic": (_LIST,),
    "trees": ("stands.gpkg",),
    "assess": ("truth/dsm_mean.tif", "truth/cover.tif", "truth/cover.csv", "truth/trees.gpkg"),
    "report": ("site.yaml", _LIST, *_SURVEY),
}
"""Files beside ``site.yaml`` that each stage reads where they exist."""

_SEE_PHOTOGRAPHS = ("orient", "match", "mosaic")


def write_inputs(site: Site) -> Path:
    """Write ``inputs/<verb>.json``: the statements and the digests of the files that a stage reads.

    A site says for itself which files it has, and some lie elsewhere; a pipeline that must name its
    dependencies cannot. It depends on these lists instead.

    Returns
    -------
    Path
        The folder, ``data/products/<site>/inputs``.

    Raises
    ------
    SiteError
        If a file cannot be read, or the folder cannot be written.
    """
    folder = site.products / "inputs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SiteError(
            f"{folder}: cannot be written ({error}). Free space or choose another root."
        ) from error
    known: dict[Path, str] = {}
    for verb in STATED:
        write_json(_inputs(site, verb, known), folder / f"{verb}.json")
    return folder


def _inputs(site: Site, verb: str, known: dict[Path, str]) -> dict[str, Any]:
    named = {name: getattr(site, name) for name in NAMED.get(verb, ()) if getattr(site, name) is not None}
    beside = {name: site.folder / name for name in BESIDE.get(verb, ()) if (site.folder / name).exists()}
    if verb in _SEE_PHOTOGRAPHS:
        beside |= {f"photographs/{p.name}": p.path for p in site.photographs}
    return {
        "stated": {name: _statement(getattr(site, name)) for name in STATED[verb]},
        "files": {name: _digest(path, known) for name, path in (named | beside).items()},
    }


def _statement(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: asdict(camera) for name, camera in sorted(value.items())}
    if value is None or isinstance(value, str | float | int):
        return value
    return list(value) if isinstance(value, Iterable) and not hasattr(value, "to_wkt") else value.to_wkt()


def _digest(path: Path, known: dict[Path, str]) -> str:
    """Digest of a file; of a shapefile, of its parts."""
    if path not in known:
        parts = (
            [path.with_suffix(end) for end in (".dbf", ".prj", ".shp")] if path.suffix == ".shp" else [path]
        )
        digest = hashlib.blake2b(digest_size=16)
        try:
            for part in parts:
                if part == path or part.exists():
                    with part.open("rb") as file:
                        digest.update(hashlib.file_digest(file, "blake2b").digest())
        except OSError as error:
            raise SiteError(
                f"{path}: cannot be read ({error}). Restore it, or take it off the site."
            ) from error
        known[path] = digest.hexdigest()
    return known[path]
