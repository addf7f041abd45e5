"""Studies: running the chain many times, and comparing what comes out."""

from workbench.studies.correlation import local_correlation
from workbench.studies.registration import coregistration, follow_objects
from workbench.studies.reproducibility import Reproducibility, agreement, reproducibility, share_by_distance
from workbench.studies.time_series import ObjectShifts, object_shifts, reproducible_dates

__all__ = [
    "ObjectShifts",
    "Reproducibility",
    "agreement",
    "coregistration",
    "follow_objects",
    "local_correlation",
    "object_shifts",
    "repeat_chain",
    "reproducibility",
    "reproducible_dates",
    "share_by_distance",
]


def __getattr__(name: str):
    # Repetitions pull in the whole chain; a correlation in a notebook does not need it.
    if name == "repeat_chain":
        from workbench.studies.repetitions import repeat_chain

        return repeat_chain
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
