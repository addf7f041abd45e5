"""Interactive panel of the reproducibility of mosaics: threshold and window beside map, shares, histogram."""

from __future__ import annotations

from pathlib import Path

import holoviews as hv
import holoviews.plotting.bokeh  # options of elements need it
import numpy as np
import pandas as pd
import panel as pn
import xarray as xr

from workbench.errors import StudyError
from workbench.figures.controls import write_button
from workbench.rasters import Grid, match_grid, read_raster
from workbench.site import Site
from workbench.site.tables import read_table
from workbench.studies.correlation import Method
from workbench.studies.repetitions import common_area
from workbench.studies.reproducibility import NOT_COMPARED, Reproducibility, reproducibility

_LONGEST = 700  # Pixels of the pictures; more than a screen shows of half a panel.
_PRODUCT = "seed_*/data/products/*/ortho"


class ReproducibilityPanel:
    """Two limits on a stack of repeated mosaics, and what they call reproducible.

    The correlation is computed anew when the window, the method, or the surface changes; it is kept for
    combinations that were shown before.
    """

    def __init__(
        self, site: Site, folder: Path, *, params: Path | None = None, largest: float = 60.0
    ) -> None:
        """``folder`` is that of the study; ``largest`` bounds the shown area, metres along an edge."""
        self.site, self.folder, self.params, self.largest = site, folder, params, largest
        surfaces = sorted({path.stem.removeprefix("ortho_") for path in folder.glob(f"{_PRODUCT}_*.tif")})
        if not surfaces:
            raise StudyError(
                f"{folder}: no repeated mosaics. Run `workbench study reproducibility --site {site.name}`."
            )
        self.surface = pn.widgets.RadioButtonGroup(name="Surface", options=surfaces)
        self.threshold = pn.widgets.FloatSlider(
            name="Identical from a correlation of", start=0.5, end=1.0, step=0.01, value=0.95
        )
        self.window = pn.widgets.DiscreteSlider(name="Window (cells)", options=[3, 5, 7, 9, 11, 15], value=5)
        self.method = pn.widgets.Select(name="Correlation", options=["pearson", "spearman"])
        self._mosaics: dict[str, list[xr.DataArray]] = {}
        self._results: dict[tuple[str, float, int, str], Reproducibility] = {}

    def panel(self) -> pn.Column:
        """The panel as one object to show or to serve."""
        limits = (self.surface, self.threshold.param.value_throttled, self.window, self.method)
        parts: list[pn.viewable.Viewable] = [
            pn.Row(self.surface, self.threshold, self.window, self.method),
            pn.Row(pn.bind(self.map, *limits), pn.bind(self.orthophoto, self.surface)),
            pn.Row(pn.bind(self.shares, *limits), pn.bind(self.histogram, *limits)),
        ]
        if self.params is not None:
            parts.append(write_button(self.params, self.values))
        return pn.Column(*parts)

    def values(self) -> dict[str, float | int | str]:
        """What the button writes into the parameters."""
        return {
            "study.identical_from": self.threshold.value,
            "study.correlation_window": self.window.value,
            "study.correlation_method": self.method.value,
        }

    def result(self, surface: str, threshold: float, window: int, method: Method) -> Reproducibility:
        """The reproducibility layer at these limits."""
        key = (surface, threshold, window, method)
        if key not in self._results:
            self._results[key] = reproducibility(
                self.mosaics(surface),
                threshold=threshold,
                window=window,
                method=method,
            )
        return self._results[key]

    def mosaics(self, surface: str) -> list[xr.DataArray]:
        """The middle of the repeated mosaics on the area that all have."""
        if surface not in self._mosaics:
            found = common_area(
                [read_raster(path) for path in sorted(self.folder.glob(f"{_PRODUCT}_{surface}.tif"))]
            )
            grid = Grid.of(found[0])
            half = int(min(self.largest / grid.resolution, min(grid.shape)) / 2)
            rows = slice(max(grid.height // 2 - half, 0), grid.height // 2 + half)
            columns = slice(max(grid.width // 2 - half, 0), grid.width // 2 + half)
            self._mosaics[surface] = [mosaic.isel(y=rows, x=columns).load() for mosaic in found]
        return self._mosaics[surface]

    def map(self, surface: str, threshold: float, window: int, method: Method) -> hv.Image:
        """Pairs in which a pixel is identical; yellow in all, blue in none."""
        result = self.result(surface, threshold, window, method)
        values = result.layer.values.astype(np.float32)
        values[result.layer.values == NOT_COMPARED] = np.nan
        step = max(-(-max(values.shape) // _LONGEST), 1)
        return hv.Image(
            values[::step, ::step], bounds=Grid.of(result.layer).bounds, kdims=["east", "north"]
        ).opts(
            cmap="viridis",
            clim=(0, result.pairs),
            colorbar=True,
            width=560,
            height=460,
            data_aspect=1,
            title=f"identical in so many of {result.pairs} pairs",
            tools=["hover"],
        )

    def orthophoto(self, surface: str) -> hv.RGB:
        """The first of the mosaics."""
        mosaic = self.mosaics(surface)[0]
        step = max(-(-max(mosaic.shape[1:]) // _LONGEST), 1)
        colours = np.moveaxis(mosaic.values[:3, ::step, ::step], 0, -1)
        return hv.RGB(
            colours / np.iinfo(colours.dtype).max, bounds=Grid.of(mosaic).bounds, kdims=["east", "north"]
        ).opts(width=500, height=460, data_aspect=1, title="one of the orthophotos")

    def shares(self, surface: str, threshold: float, window: int, method: Method) -> pn.pane.DataFrame:
        """Share of the pixels that are identical in all pairs, by land cover where truth tells it."""
        result = self.result(surface, threshold, window, method)
        table = result.share_by(*self._cover(Grid.of(result.layer), result.layer))
        shown = table[table.pixels > 0].assign(share=(100 * table["share"]).round(1))
        return pn.pane.DataFrame(shown.rename(columns={"share": "identical in all pairs (%)"}), index=False)

    def histogram(self, surface: str, threshold: float, window: int, method: Method) -> hv.Bars:
        """Pixels by the number of pairs in which they are identical."""
        table: pd.DataFrame = self.result(surface, threshold, window, method).histogram()
        return hv.Bars(table, "identical_pairs", "share").opts(
            width=560, height=260, xlabel="pairs in which a pixel is identical", ylabel="share of the pixels"
        )

    def _cover(self, grid: Grid, layer: xr.DataArray) -> tuple[xr.DataArray, dict[int, str]]:
        if self.site.truth is None:
            return layer, {}
        cover = match_grid(read_raster(self.site.truth / "cover.tif"), grid, resampling="nearest")
        rows = read_table(self.site.truth / "cover.csv", ["code", "cover"])
        return cover, {int(row["code"]): row["cover"] for _, row in rows}
