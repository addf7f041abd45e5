"""Pieces that interactive panels share: writing chosen values to ``params.yaml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import panel as pn

from workbench.errors import ParameterError
from workbench.params import update_parameters
from workbench.stages import FOLDERS

_AFTER: dict[str, tuple[str, ...]] = {
    "simulate": tuple(FOLDERS),
    "orient": ("orient", "match", "surface", "mosaic", "reed", "trees", "assess", "report"),
    "match": ("match", "surface", "mosaic", "reed", "trees", "assess", "report"),
    "surface": ("surface", "mosaic", "reed", "trees", "assess", "report"),
    "mosaic": ("mosaic", "trees", "assess", "report"),
    "reed": ("reed", "report"),
    "trees": ("trees", "assess", "report"),
    "assess": ("assess", "report"),
    "report": ("report",),
}


def stages_to_rerun(sections: tuple[str, ...]) -> tuple[str, ...]:
    """Stages that run again after sections of ``params.yaml`` changed, in the order of the chain."""
    again = {stage for section in sections for stage in _AFTER.get(section, ())}
    return tuple(stage for stage in FOLDERS if stage in again)


def write_button(path: Path | str, values: Callable[[], Mapping[str, Any]]) -> pn.Column:
    """A button that writes values into ``params.yaml`` and says what will run again.

    Parameters
    ----------
    path
        The file; comments in it stay.
    values
        Called at the click: new values by dotted path, as ``{"trees.min_height": 4.0}``.
    """
    button = pn.widgets.Button(name=f"Write to {Path(path).name}", button_type="primary")
    answer = pn.pane.Markdown("", sizing_mode="stretch_width")

    def write(_: Any) -> None:
        try:
            changed = update_parameters(path, values())
        except (ParameterError, OSError) as error:
            answer.object = f"Not written: {error}"
            return
        again = ", ".join(stages_to_rerun(changed))
        answer.object = f"Written. `dvc repro` runs again: **{again}**." if changed else "Nothing changed."

    button.on_click(write)
    return pn.Column(button, answer)
