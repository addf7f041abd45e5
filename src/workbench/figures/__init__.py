"""Figures and the report."""

from workbench.figures.maps import (
    draw_classes,
    draw_orthophoto,
    draw_surface,
    draw_values,
    figure,
    hillshade,
)

__all__ = [
    "draw_classes",
    "draw_orthophoto",
    "draw_surface",
    "draw_values",
    "figure",
    "hillshade",
    "report_site",
]


def __getattr__(name: str):
    # The report reads the products of every stage; a map in a notebook does not need it.
    if name == "report_site":
        from workbench.figures.report import report_site

        return report_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
