"""Measuring control points in photographs by clicking: a small tool for a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

import holoviews as hv
import holoviews.plotting.bokeh  # options of elements need it
import numpy as np
import pandas as pd
import panel as pn

from workbench.errors import OrientationError, WorkbenchError
from workbench.orientation import Block
from workbench.orientation.predict import intersect, predict_observation
from workbench.photographs import read_photograph
from workbench.site import Observation, Site
from workbench.site.control import render_observations
from workbench.site.files import write_text

Source = Literal["measured", "surveyed", "nothing"]
_LONGEST = 1100  # Pixels of the overview, which a browser takes without delay.
_CHIP = 80  # Half the edge of the part that is shown pixel by pixel.
_SUSPECT = 5.0  # Residual beyond which a click is named: several times what a careful hand misses by.


@dataclass
class Measurements:
    """Image measurements of surveyed points, in the making.

    Examples
    --------
    >>> measured = Measurements(site, read_block(site.products / "orientation", site))
    >>> measured.measure("T1", "DJI_0018.JPG", 1203.4, 877.9)
    >>> measured.measure("T1", "DJI_0019.JPG", 1214.0, 1411.2)
    >>> places, source = measured.predict("T1")   # where T1 should be in all the others
    """

    site: Site
    """The site; its observations are the start."""
    block: Block | None = None
    """Oriented photographs, for predictions; None before the first orientation."""
    places: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    """Column and row by point and photograph."""

    def __post_init__(self) -> None:
        for o in self.site.observations:
            self.places.setdefault((o.name, o.photo), (o.column, o.row))

    @property
    def points(self) -> list[str]:
        """Names of the surveyed points."""
        return [point.name for point in self.site.control]

    def measure(self, point: str, photo: str, column: float, row: float) -> None:
        """Note where a point is in a photograph; an earlier measurement there is replaced.

        Raises
        ------
        OrientationError
            If point or photograph are unknown, or the place is outside the photograph.
        """
        if point not in self.points:
            raise OrientationError(f"{point} is no point of control.csv: add its coordinates there first.")
        width, height = self._size(photo)
        if not (0 <= column < width and 0 <= row < height):
            raise OrientationError(
                f"{point} at column {column:.1f}, row {row:.1f} is outside of {photo}, {width} x {height} px."
            )
        self.places[point, photo] = (float(column), float(row))

    def remove(self, point: str, photo: str) -> None:
        """Forget a measurement; nothing happens where there is none."""
        self.places.pop((point, photo), None)

    def observations(self, point: str | None = None) -> tuple[Observation, ...]:
        """Measurements by point and photograph, of one point or all."""
        return tuple(
            Observation(name, photo, *place)
            for (name, photo), place in sorted(self.places.items())
            if point in (None, name)
        )

    def predict(self, point: str) -> tuple[dict[str, np.ndarray], Source]:
        """Where a point should be, by photograph, and from what.

        From its measurements once there are two; before that from its surveyed place, as well as the block
        is placed already.
        """
        if self.block is None:
            return {}, "nothing"
        try:
            return predict_observation(self.block, self.observations(point)), "measured"
        except OrientationError:
            surveyed = next(p for p in self.site.control if p.name == point)
        place = np.array([[surveyed.x, surveyed.y, surveyed.z]])
        seen = {p.name: p.project(place)[0] for p in self.block if p.sees(place)[0]}
        return seen, "surveyed" if seen else "nothing"

    def residuals(self, point: str) -> pd.DataFrame:
        """Measured minus predicted from the other photographs, px, largest first; empty below three.

        A click beside the point stands out here: its own prediction does not know it.
        """
        rows = []
        if self.block is not None:
            oriented = {photograph.name for photograph in self.block}
            known = [o for o in self.observations(point) if o.photo in oriented]
            for left_out in known if len(known) > 2 else ():
                others = [o for o in known if o is not left_out]
                off = _miss(self.block, left_out, others)
                if off is not None:
                    rows.append({"photo": left_out.photo, "residual_px": off})
        table = pd.DataFrame(rows, columns=["photo", "residual_px"])
        return table.sort_values("residual_px", ascending=False, ignore_index=True)

    def write(self, path: Path | str | None = None) -> Path:
        """Write all measurements as ``name,photo,column,row``; into the site's folder by default."""
        path = Path(path) if path is not None else self.site.folder / "observations.csv"
        write_text(render_observations(self.observations()), path)
        return path

    def _size(self, photo: str) -> tuple[int, int]:
        try:
            camera = self.site.cameras[self.site.photograph(photo).camera]
        except KeyError as error:
            raise OrientationError(f"{photo} is no photograph of site {self.site.name}.") from error
        return camera.width, camera.height


def _miss(block: Block, measured: Observation, others: list[Observation]) -> float | None:
    """Distance of a measurement from the place that others predict, px; None where they predict none."""
    try:
        column, row = block[measured.photo].project(intersect(block, others)[None])[0]
    except OrientationError:
        return None
    return float(np.hypot(measured.column - column, measured.row - row))


class ClickTool:
    """Choose a point and a photograph, click roughly on the left, exactly on the right, save.

    Photographs in which the point is expected come first; the cross shows where.
    """

    def __init__(self, measurements: Measurements, path: Path | None = None) -> None:
        self.measurements, self.path = measurements, path
        names = [photograph.name for photograph in measurements.site.photographs]
        self.point = pn.widgets.Select(name="Point", options=measurements.points)
        self.photo = pn.widgets.Select(name="Photograph", options=names)
        self.rough, self.exact = hv.streams.Tap(x=None, y=None), hv.streams.Tap(x=None, y=None)
        self.centre: tuple[float, float] | None = None
        self.message = pn.pane.Markdown("", sizing_mode="stretch_width")
        self.table = pn.pane.DataFrame(pd.DataFrame(), index=False)
        self.overview = pn.pane.HoloViews(None, linked_axes=False)
        self.chip = pn.pane.HoloViews(None, linked_axes=False)
        self._remove = pn.widgets.Button(name="Remove this measurement")
        self._save = pn.widgets.Button(name="Save observations.csv", button_type="primary")
        self.point.param.watch(lambda _: self._choose_point(), "value")
        self.photo.param.watch(lambda _: self._show_photograph(), "value")
        self.rough.add_subscriber(self._look)
        self.exact.add_subscriber(self._measure)
        self._remove.on_click(self._forget)
        self._save.on_click(self._save_clicked)
        self._choose_point()

    def panel(self) -> pn.Column:
        """The tool as one object to show or to serve."""
        return pn.Column(
            pn.Row(self.point, self.photo, pn.Column(self._remove, self._save)),
            self.message,
            pn.Row(self.overview, self.chip, self.table),
        )

    def save(self) -> Path:
        """Write the observations, and say where."""
        path = self.measurements.write(self.path)
        self.message.object = f"{len(self.measurements.places)} measurements are in `{path}`."
        return path

    def _choose_point(self) -> None:
        expected, _ = self.measurements.predict(self.point.value)
        names = [photograph.name for photograph in self.measurements.site.photographs]
        marks = {name: self._mark(name, expected) for name in names}
        order = sorted(names, key=lambda name: (name not in expected, name))
        options = {f"{marks[name]} {name}": name for name in order}
        before = self.photo.value
        self.photo.options = options
        todo = [name for name in order if (self.point.value, name) not in self.measurements.places]
        here = [name for name in todo if name in expected] or [n for n in order if n in expected] or todo
        self.photo.value = next(iter(here), order[0])
        if self.photo.value == before:
            self._show_photograph()

    def _mark(self, photo: str, expected: Mapping[str, Any]) -> str:
        measured = (self.point.value, photo) in self.measurements.places
        return "●" if measured else "○" if photo in expected else "·"

    def _show_photograph(self) -> None:
        point, photo = self.point.value, self.photo.value
        expected, source = cast(tuple[dict, str], self.measurements.predict(point))
        self.image = read_photograph(self.measurements.site.photograph(photo).path)
        self.centre = self.measurements.places.get((point, photo))
        if self.centre is None and photo in expected:
            self.centre = (float(expected[photo][0]), float(expected[photo][1]))
        if expected and photo not in expected:
            source = "elsewhere"
        self.message.object = {
            "elsewhere": "The point is not expected in this photograph: choose one that is marked ○.",
            "measured": "The cross is where the other measurements say that it should be.",
            "surveyed": "The cross comes from the surveyed place; two measurements make it exact.",
            "nothing": "Look for the point and click on it; after two photographs it is predicted.",
        }[source]
        self._draw()

    def _look(self, x: float | None, y: float | None) -> None:
        if x is not None and y is not None:
            self.centre = (x, y)
            self._draw()

    def _measure(self, x: float | None, y: float | None) -> None:
        if x is None or y is None:
            return
        point, photo = self.point.value, self.photo.value
        try:
            self.measurements.measure(point, photo, x, y)
        except WorkbenchError as error:
            self.message.object = f"Not measured: {error}"
            return
        residuals = self.measurements.residuals(point)
        wrong = residuals[residuals.residual_px > _SUSPECT]
        self.message.object = f"{point} in {photo}: column {x:.1f}, row {y:.1f}."
        if len(wrong):
            worst = wrong.iloc[0]
            self.message.object += (
                f" **{worst.photo} contradicts the other photographs by {worst.residual_px:.0f} px.**"
            )
        self.centre = (x, y)
        self._draw()

    def _save_clicked(self, _: Any) -> None:
        self.save()

    def _forget(self, _: Any) -> None:
        self.measurements.remove(self.point.value, self.photo.value)
        self._show_photograph()

    def _draw(self) -> None:
        height, width = self.image.shape[:2]
        step = max(int(np.ceil(max(width, height) / _LONGEST)), 1)
        self.overview.object = self._picture((0, 0, width, height), step, self.rough, 560, "roughly")
        column, row = self.centre or (width / 2, height / 2)
        left, top = int(np.clip(column - _CHIP, 0, width - 1)), int(np.clip(row - _CHIP, 0, height - 1))
        part = (left, top, min(left + 2 * _CHIP, width), min(top + 2 * _CHIP, height))
        self.chip.object = self._picture(part, 1, self.exact, 420, "exactly")
        self.table.object = self._summary()

    def _picture(
        self, part: tuple[int, int, int, int], step: int, stream: Any, size: int, title: str
    ) -> hv.Overlay:
        left, top, right, bottom = part
        pixels = self.image[top:bottom:step, left:right:step]
        colours = np.repeat(pixels[..., :1], 3, axis=2) if pixels.shape[2] < 3 else pixels[..., :3]
        white = np.iinfo(colours.dtype).max if colours.dtype == np.uint8 else np.percentile(colours, 99)
        shown = np.clip(colours[::-1] / max(float(white), 1.0), 0, 1)
        # Rows grow downwards, as in the observations.
        picture = hv.RGB(shown, bounds=(left, top, right, bottom), kdims=["column", "row"])
        shape = max(right - left, 1), max(bottom - top, 1)
        picture = picture.opts(
            width=size,
            height=int(size * shape[1] / shape[0]),
            invert_yaxis=True,
            title=f"Click {title}",
            tools=["wheel_zoom", "pan", "reset"],
            active_tools=["wheel_zoom"],
        )
        stream.source = picture
        return picture * self._marks(part)

    def _marks(self, part: tuple[int, int, int, int]) -> hv.Overlay:
        left, top, right, bottom = part
        point, photo = self.point.value, self.photo.value
        expected, _ = self.measurements.predict(point)
        marks = []
        for places, style in (
            ([tuple(expected[photo])] if photo in expected else [], {"color": "cyan", "marker": "cross"}),
            (
                [self.measurements.places[point, photo]]
                if (point, photo) in self.measurements.places
                else [],
                {"color": "red", "marker": "circle_cross"},
            ),
        ):
            inside = [(x, y) for x, y in places if left <= x < right and top <= y < bottom]
            points = hv.Points(inside, kdims=["column", "row"])
            marks.append(points.opts(size=16, fill_alpha=0, line_width=2, **style))
        return hv.Overlay(marks)

    def _summary(self) -> pd.DataFrame:
        point = self.point.value
        rows = [
            {"photo": o.photo, "column": round(o.column, 1), "row": round(o.row, 1)}
            for o in self.measurements.observations(point)
        ]
        table = pd.DataFrame(rows, columns=["photo", "column", "row"])
        residuals = self.measurements.residuals(point).round(2)
        return table.merge(residuals, on="photo", how="left")


def click_tool(site: Site, block: Block | None = None, path: Path | None = None) -> ClickTool:
    """A tool to measure the surveyed points of a site in its photographs.

    Parameters
    ----------
    site
        With a control file.
    block
        Oriented photographs, so that points are predicted; a first orientation by positions will do.
    path
        File to save to; ``observations.csv`` of the site by default.

    Raises
    ------
    OrientationError
        If the site has no surveyed points.
    """
    if not site.control:
        raise OrientationError(f"Site {site.name} has no control.csv: there are no points to measure.")
    return ClickTool(Measurements(site, block), path)
