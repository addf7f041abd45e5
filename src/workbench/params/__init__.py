"""``params.yaml``: every threshold with its default, unit, range and source.

Defaults live in the typed models of this package and nowhere else; ``params.yaml`` is their written
form (``python -m workbench.params`` writes it anew, with the values that it has).
"""

from workbench.params.assess import AssessParameters
from workbench.params.base import Section, parameter
from workbench.params.file import Parameters, load_parameters, render_parameters, update_parameters
from workbench.params.match import MatchParameters
from workbench.params.mosaic import MosaicParameters
from workbench.params.orient import OrientParameters
from workbench.params.reed import ReedParameters
from workbench.params.report import ReportParameters
from workbench.params.simulate import SimulateParameters
from workbench.params.study import StudyParameters
from workbench.params.surface import SurfaceParameters
from workbench.params.trees import TreesParameters

__all__ = [
    "AssessParameters",
    "MatchParameters",
    "MosaicParameters",
    "OrientParameters",
    "Parameters",
    "ReedParameters",
    "ReportParameters",
    "Section",
    "SimulateParameters",
    "StudyParameters",
    "SurfaceParameters",
    "TreesParameters",
    "load_parameters",
    "parameter",
    "render_parameters",
    "update_parameters",
]
