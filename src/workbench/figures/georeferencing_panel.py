"""Interactive panel of the georeferencing: thresholds of tie points, the errors that they lead to, a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import holoviews as hv
import holoviews.plotting.bokeh  # options of elements need it
import numpy as np
import pandas as pd
import panel as pn

from workbench.figures.controls import write_button
from workbench.orientation.optimise import Optimisation
from workbench.points import read_points
from workbench.site import Site
from workbench.stages import FOLDERS

_ATTRIBUTES = {
    "reprojection_error": "Reprojection error (px)",
    "reconstruction_uncertainty": "Reconstruction uncertainty",
    "projection_accuracy": "Projection accuracy",
    "image_count": "Image count",
}
_KEPT, _DROPPED, _CHOSEN = "#0b3d91", "#d98200", "#d1495b"


class GeoreferencingPanel:
    """Limits on the tie points: which of them stay, and what the checkpoints say of it.

    The errors by threshold are those of an optimisation that was computed before; moving a slider
    computes nothing, it looks them up.
    """

    def __init__(self, site: Site, optimisation: Optimisation, params: Path | None = None) -> None:
        self.optimisation = optimisation
        self.points = tie_point_table(site)
        self.errors = optimisation.table()
        thresholds = list(self.errors["threshold_px"])
        self.threshold = pn.widgets.DiscreteSlider(
            name="Largest reprojection error (px)", options=thresholds, value=optimisation.threshold
        )
        self.uncertainty = pn.widgets.FloatSlider(
            name="Largest reconstruction uncertainty", start=2, end=100, value=50, step=1
        )
        self.accuracy = pn.widgets.FloatSlider(
            name="Largest projection accuracy", start=1, end=20, value=10, step=0.5
        )
        self.attribute = pn.widgets.Select(
            name="Colour", options={label: name for name, label in _ATTRIBUTES.items()}
        )
        self.params = params

    def panel(self) -> pn.Column:
        """The panel as one object to show or to serve."""
        limits = (self.threshold, self.uncertainty, self.accuracy)
        parts: list[Any] = [
            pn.Row(*limits, self.attribute),
            pn.bind(self.summary, *limits),
            pn.Row(
                pn.pane.HoloViews(hv.DynamicMap(pn.bind(self.curves, self.threshold))),
                pn.pane.HoloViews(hv.DynamicMap(pn.bind(self.map, *limits, self.attribute))),
            ),
        ]
        if self.params is not None:
            parts.append(write_button(self.params, self.values))
        return pn.Column(*parts)

    def values(self) -> dict[str, float]:
        """What the button writes into the parameters."""
        return {
            "orient.max_reprojection_error": self.threshold.value,
            "orient.max_reconstruction_uncertainty": self.uncertainty.value,
            "orient.max_projection_accuracy": self.accuracy.value,
        }

    def kept(self, threshold: float, uncertainty: float, accuracy: float) -> np.ndarray:
        """Tie points within all limits, (n,) bool."""
        points = self.points
        return np.asarray(
            (points.reprojection_error <= threshold)
            & (points.reconstruction_uncertainty <= uncertainty)
            & (points.projection_accuracy <= accuracy)
        )

    def summary(self, threshold: float, uncertainty: float, accuracy: float) -> pn.pane.Markdown:
        """Points that stay, and the errors at the threshold."""
        kept = int(self.kept(threshold, uncertainty, accuracy).sum())
        row = self.errors.set_index("threshold_px").loc[threshold]
        errors = ", ".join(
            f"{role} {100 * row[f'{role}_xy_m']:.1f} cm in plan, {100 * row[f'{role}_z_m']:.1f} cm in height"
            for role in ("control", "check", "verify")
            if pd.notna(row[f"{role}_xy_m"])
        )
        best = self.optimisation
        text = (
            f"**{kept} of {len(self.points)} tie points** of the oriented block lie within these limits. "
            f"At {threshold:g} px: {errors}.\n\nChosen: {best.threshold:g} px, error of the checkpoints "
            f"{100 * best.optimised_error:.1f} cm; cross-validated: {100 * best.cross_validated_error:.1f} cm"
        )
        verify = (
            "" if best.verify_error is None else f"; points of role verify: {100 * best.verify_error:.1f} cm"
        )
        ended = f" Nothing stricter: {best.stopped}." if best.stopped else ""
        return pn.pane.Markdown(f"{text}{verify}.{ended}")

    def curves(self, threshold: float) -> hv.Overlay:
        """Errors of the checkpoints over the threshold."""
        parts = [
            hv.Curve(
                (self.errors.threshold_px, self.errors[f"check_{axis}_m"]),
                "threshold (px)",
                "error of checkpoints (m)",
                label=label,
            ).opts(line_width=2)
            for axis, label in (("xy", "horizontal"), ("z", "vertical"))
        ]
        line = hv.VLine(threshold).opts(color=_CHOSEN, line_dash="dashed")
        return hv.Overlay([*parts, line]).opts(
            width=430, height=360, logx=True, logy=True, legend_position="top_left"
        )

    def map(self, threshold: float, uncertainty: float, accuracy: float, attribute: str) -> hv.Overlay:
        """Tie points that stay, coloured by an attribute, and those that go."""
        kept = self.kept(threshold, uncertainty, accuracy)
        stay, go = self.points[kept], self.points[~kept]
        high = float(np.percentile(self.points[attribute], 98))
        return (
            hv.Points(stay, ["east", "north"], [attribute]).opts(
                color=attribute,
                cmap="viridis",
                clim=(float(self.points[attribute].min()), max(high, 1e-6)),
                colorbar=True,
                size=3,
                tools=["hover"],
            )
            * hv.Points(go, ["east", "north"], [attribute]).opts(color=_DROPPED, size=4, marker="x")
        ).opts(width=620, height=420, data_aspect=1, title=f"{_ATTRIBUTES[attribute]}; dropped: orange")


def tie_point_table(site: Site) -> pd.DataFrame:
    """Tie points of an oriented site: east, north, height and their attributes."""
    xyz, _, attributes = read_points(site.products / FOLDERS["orient"] / "tie_points.laz")
    columns = {name: attributes[name].astype(float) for name in _ATTRIBUTES}
    return pd.DataFrame({"east": xyz[:, 0], "north": xyz[:, 1], "height": xyz[:, 2], **columns})


def residual_arrows(site: Site, magnify: float | None = None) -> hv.Overlay:
    """Residuals of surveyed points as arrows, horizontal in blue and vertical in red.

    Parameters
    ----------
    magnify
        Length on the map over length on the ground; by default the largest fills a tenth of the block.
    """
    table = pd.read_csv(site.products / FOLDERS["orient"] / "control.csv").dropna(subset=["dx"])
    places = pd.DataFrame([(p.name, p.x, p.y) for p in site.control], columns=["name", "x", "y"])
    table = table.merge(places, on="name")
    largest = float(np.abs(table[["dx", "dy", "dz"]].to_numpy()).max())
    extent = max(float(np.ptp(table.x)), float(np.ptp(table.y)), 1.0)
    scale = magnify or 0.1 * extent / max(largest, 1e-9)
    x, y = table.x.to_numpy(), table.y.to_numpy()
    dx, dy, dz = (scale * table[name].to_numpy() for name in ("dx", "dy", "dz"))
    horizontal, vertical = np.c_[x, y, x + dx, y + dy], np.c_[x, y, x, y + dz]
    points = hv.Points(table, ["x", "y"], ["name", "role", "dx", "dy", "dz", "reprojection_px"])
    return (
        hv.Segments(horizontal, label="horizontal").opts(color=_KEPT, line_width=2)
        * hv.Segments(vertical, label="vertical").opts(color=_CHOSEN, line_width=2)
        * points.opts(size=6, color="black", tools=["hover"])
    ).opts(width=620, height=420, data_aspect=1, title=f"Residuals, {scale:.0f} times enlarged")
