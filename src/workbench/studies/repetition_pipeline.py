"""The repetitions of a site as stages of DVC, each cached by itself."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from workbench.params import Parameters
from workbench.site import Site
from workbench.site.files import write_text
from workbench.stages import FOLDERS

_SECTIONS = ("orient", "match", "surface", "mosaic", "study")
_CODE = {"orient": ("orientation",), "surface": ("matching", "surface"), "mosaic": ("mosaic",)}
_NOTE = """\
# Written by `workbench study reproducibility`, which computes the same steps itself. In a DVC repository
#   dvc repro {path}
# records and caches each step of each repetition, so that they can be pushed, pulled and compared.
"""


def write_pipeline(
    site: Site, parameters: Parameters, seeds: Sequence[int], surfaces: Sequence[str], folder: Path
) -> Path:
    """Write ``dvc.yaml`` and the ``params.yaml`` that it reads into the folder of a study.

    Each stage calls the command line for one step of one repetition. What the step has computed already
    is kept (``persist``): DVC and the command agree on what is done.

    Returns
    -------
    Path
        ``dvc.yaml``.
    """
    root = _relative(site.root, folder)
    command = f"workbench study reproducibility --site {site.name} --root {root} --params params.yaml"
    command += f" --repeat {len(seeds)}" + "".join(f" --surface {surface}" for surface in surfaces)
    inputs = [_relative(site.folder / name, folder) for name in ("photographs.csv", "control.csv")]
    inputs = [name for name in inputs if (folder / name).exists()]
    first = f"seed_{seeds[0]:03d}"
    stages: dict[str, Any] = {}
    mosaics: list[str] = []
    for seed in seeds:
        home = f"seed_{seed:03d}"
        products = f"{home}/data/products/{site.name}"
        steps = {name: f"{home}/steps/{name}.json" for name in ("orient", "surface")}
        sizes = [] if home == first else [f"{first}/steps/surface.json"]
        stages[f"orient-{seed}"] = _stage(
            f"{command} --step {seed}/orient",
            [*inputs, *_code("orient", site.root, folder)],
            ["orient"],
            [f"{products}/{FOLDERS['orient']}", steps["orient"]],
        )
        stages[f"surface-{seed}"] = _stage(
            f"{command} --step {seed}/surface",
            [steps["orient"], *sizes, *_code("surface", site.root, folder)],
            ["match", "surface"],
            [f"{products}/{FOLDERS['surface']}", steps["surface"]],
        )
        for surface in surfaces:
            name = f"mosaic_{surface}"
            # The first mosaic of the first repetition decides the cell of all others.
            decided = (
                [] if not mosaics else [mosaics[0].replace("ortho_", "mosaic_").replace(".tif", ".json")]
            )
            ortho = f"{products}/ortho_{surface}.tif"
            crop = [f"{products}/crop_{surface}.gpkg"] if parameters.mosaic.crop else []
            stages[f"mosaic-{surface}-{seed}"] = _stage(
                f"{command} --step {seed}/{name}",
                [steps["surface"], *decided, *_code("mosaic", site.root, folder)],
                ["mosaic"],
                [ortho, *crop, f"{products}/{name}.json", f"{home}/steps/{name}.json"],
            )
            mosaics.append(ortho)
    tables = ["reproducibility.csv", "histogram.csv", "errors.csv"]
    tables += ["subset_agreement.csv"] if len(seeds) >= 10 else []
    layers = [f"reproducibility_{surface}.tif" for surface in surfaces]
    stages["compare"] = _stage(f"{command} --step compare", mosaics, ["study"], [*layers, *tables])
    values = {name: getattr(parameters, name).model_dump(mode="json") for name in _SECTIONS}
    write_text(_yaml(values), folder / "params.yaml")
    path = folder / "dvc.yaml"
    write_text(_NOTE.format(path=_relative(path, site.root)) + _yaml({"stages": stages}), path)
    return path


def _stage(command: str, needs: list[str], sections: list[str], outputs: list[str]) -> dict[str, Any]:
    outs = [{output: {"persist": True}} for output in outputs]
    return {"cmd": command, "deps": needs, "params": sections, "outs": outs}


def _code(step: str, root: Path, folder: Path) -> list[str]:
    """Source of a step, where the root is the repository of the workbench."""
    packages = [root / "src" / "workbench" / package for package in _CODE[step]]
    return [_relative(package, folder) for package in packages if package.is_dir()]


def _relative(path: Path, start: Path) -> str:
    return Path(os.path.relpath(path.absolute(), start.absolute())).as_posix()


def _yaml(values: Any) -> str:
    stream = io.StringIO()
    writer = YAML()
    writer.width = 4096
    writer.dump(values, stream)
    return stream.getvalue()
