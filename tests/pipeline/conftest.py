"""A small shore with reed and a few trees, photographed and processed once for all tests of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from workbench.chain import run_stage
from workbench.cli import STAGES, _stage_loader
from workbench.params import Parameters, render_parameters
from workbench.site import load_site
from workbench.stages import FOLDERS
from workbench.virtual import simulate_scene

POND = Path(__file__).parents[1] / "virtual" / "pond.yaml"


@pytest.fixture(scope="session")
def pond_parameters() -> Parameters:
    """Parameters of the small site."""
    simulate = {"truth_resolution": 0.2, "supersampling": 1}
    return Parameters(simulate=simulate, orient={"max_features": 2000})


@pytest.fixture(scope="session")
def run_verb(pond_parameters) -> Callable[[str, Path], None]:
    """Run one stage on the small site below a root."""

    def run(verb: str, root: Path) -> None:
        module, function, _ = STAGES[verb]
        stage = _stage_loader(module, function)
        run_stage(verb, stage, load_site("pond", root), pond_parameters, lambda text: None, True)

    return run


@pytest.fixture(scope="session")
def pond(tmp_path_factory, pond_parameters, run_verb) -> Path:
    """Root with the small site, all its products and its parameters. Do not write into it."""
    root = tmp_path_factory.mktemp("pond")
    (root / "params.yaml").write_text(render_parameters(pond_parameters), encoding="utf-8")
    flight = {"forward_overlap": 0.75, "strips": 2, "side_overlap": 0.6, "reduction": 8}
    simulate_scene(POND, root, pond_parameters, flight_overrides=flight)
    for verb in FOLDERS:
        run_verb(verb, root)
    return root
