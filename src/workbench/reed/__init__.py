"""Aquatic reed: heights, extent, density, front and status [reed paper 2.5]."""

from workbench.reed.accuracy import (
    Agreement,
    References,
    agreements,
    density_agreement,
    extent_agreement,
    status_agreement,
)
from workbench.reed.change import ReedChange, compare_dates
from workbench.reed.density import CellStatistics, cell_statistics, classify_cells, density_cells
from workbench.reed.doubts import doubts, open_water
from workbench.reed.extent import ReedExtent, extent, lake_side, map_extent
from workbench.reed.field import read_field_points, read_plots
from workbench.reed.files import reed_files
from workbench.reed.front import Front, sinuosity, trace_front
from workbench.reed.heights import (
    HeightAgreement,
    agreement_by_area,
    compare_heights,
    height_at_points,
    object_height,
)
from workbench.reed.measure import ReedMetrics, ReedModel, measure_reed
from workbench.reed.stage import load_model, load_references, reed_site
from workbench.reed.status import arsi, assess_sections, classify
from workbench.reed.transects import lay_transects, strips
from workbench.reed.tuning import of_areas, tune_thresholds
from workbench.reed.uncertainty import Uncertainty, propagate, sensitivity

__all__ = [
    "Agreement",
    "CellStatistics",
    "Front",
    "HeightAgreement",
    "ReedChange",
    "ReedExtent",
    "ReedMetrics",
    "ReedModel",
    "References",
    "Uncertainty",
    "agreement_by_area",
    "agreements",
    "arsi",
    "assess_sections",
    "cell_statistics",
    "classify",
    "classify_cells",
    "compare_dates",
    "compare_heights",
    "density_agreement",
    "density_cells",
    "doubts",
    "extent",
    "extent_agreement",
    "height_at_points",
    "lake_side",
    "lay_transects",
    "load_model",
    "load_references",
    "map_extent",
    "measure_reed",
    "object_height",
    "of_areas",
    "open_water",
    "propagate",
    "read_field_points",
    "read_plots",
    "reed_files",
    "reed_site",
    "sensitivity",
    "sinuosity",
    "status_agreement",
    "strips",
    "trace_front",
    "tune_thresholds",
]
