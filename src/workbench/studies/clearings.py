"""The study of reproducibility as it is shipped: one virtual clearing in two lights, its chain repeated.

For a site of one's own there is :func:`workbench.studies.repeat_chain`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from workbench.params import Parameters
from workbench.site import load_site
from workbench.studies.repetitions import Repetitions, repeat_chain
from workbench.virtual import simulate_scene

LIGHTS: dict[str, dict[str, Any]] = {"low_sun": {}, "cloudy": {"cloudiness": 1.0}}
"""Sites, and what their flight has instead of that of scene ``clearing``: clear and overcast."""
_COARSE = {"gsd": 0.15, "reduction": 14, "forward_overlap": 0.8, "side_overlap": 0.65}
"""Flight of the quick preset: nine photographs of 0.1 megapixels."""
_REPETITIONS = 10
"""In both presets, because finding O07 compares the first five with at least ten."""


def repeat_clearings(
    root: Path,
    parameters: Parameters,
    *,
    quick: bool = False,
    repetitions: int | None = None,
    announce: Callable[[str], None] = print,
) -> list[Repetitions]:
    """Simulate the clearing in both lights where it is missing, and repeat the chain of either.

    Sites of the quick preset are called ``low_sun-quick`` and ``cloudy-quick``, and coarser. Results are in
    ``data/studies/reproducibility/<site>``.

    Raises
    ------
    StudyError, SceneError
        As :func:`workbench.studies.repeat_chain` and :func:`workbench.virtual.simulate_scene`.
    """
    scene = Path(str(files("workbench.studies") / "shipped" / "scenes" / "clearing.yaml"))
    if quick:
        simulate = parameters.simulate.model_copy(update={"truth_resolution": 0.15})
        # Of so few photographs nothing would be left without the outermost.
        study = parameters.study.model_copy(update={"crop": False})
        parameters = parameters.model_copy(update={"simulate": simulate, "study": study})
    number = repetitions or _REPETITIONS
    repeated = []
    for light, flight in LIGHTS.items():
        name = f"{light}-quick" if quick else light
        announce(f"reproducibility: {number} repetitions of {name}")
        # Photographs that are there and would come out the same are kept.
        simulate_scene(
            scene,
            root,
            parameters,
            flight_overrides={**flight, **(_COARSE if quick else {})},
            site_name=name,
        )
        site = load_site(name, root)
        repeated.append(repeat_chain(site, parameters, repetitions=number, announce=announce))
    return repeated
