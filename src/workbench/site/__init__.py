"""Sites: photographs, positions, control and references of one area on one date."""

from workbench.site.check import CheckReport, check_site
from workbench.site.control import on_a_line, read_control, read_observations
from workbench.site.estimate import CostEstimate, estimate_cost
from workbench.site.files import load_site
from workbench.site.gcp_list import read_gcp_list
from workbench.site.inputs import write_inputs
from workbench.site.model import ControlPoint, Observation, Photograph, Problem, Site
from workbench.site.navigation import NavigationFormat, read_navigation
from workbench.site.new import new_site
from workbench.site.overlap import Overlap, ground_height, overlap_map, write_overlap
from workbench.site.strips import find_strips

__all__ = [
    "CheckReport",
    "ControlPoint",
    "CostEstimate",
    "NavigationFormat",
    "Observation",
    "Overlap",
    "Photograph",
    "Problem",
    "Site",
    "check_site",
    "estimate_cost",
    "find_strips",
    "ground_height",
    "load_site",
    "new_site",
    "on_a_line",
    "overlap_map",
    "read_control",
    "read_gcp_list",
    "read_navigation",
    "read_observations",
    "write_inputs",
    "write_overlap",
]
