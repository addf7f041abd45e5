"""Studies: running the chain many times, and comparing what comes out."""

from workbench.studies.correlation import local_correlation
from workbench.studies.reproducibility import Reproducibility, reproducibility
from workbench.studies.time_series import ObjectShifts, object_shifts, reproducible_dates

__all__ = [
    "ObjectShifts",
    "Reproducibility",
    "local_correlation",
    "object_shifts",
    "reproducibility",
    "reproducible_dates",
]
