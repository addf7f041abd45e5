"""Sites: photographs, positions, control and references of one area on one date."""

from workbench.site.check import CheckReport, Problem, check_site
from workbench.site.control import read_control, read_gcp_list, read_observations
from workbench.site.files import load_site
from workbench.site.model import ControlPoint, Observation, Photograph, Site
from workbench.site.navigation import NavigationFormat, read_navigation
from workbench.site.new import new_site
from workbench.site.strips import find_strips

__all__ = [
    "CheckReport",
    "ControlPoint",
    "NavigationFormat",
    "Observation",
    "Photograph",
    "Problem",
    "Site",
    "check_site",
    "find_strips",
    "load_site",
    "new_site",
    "read_control",
    "read_gcp_list",
    "read_navigation",
    "read_observations",
]
