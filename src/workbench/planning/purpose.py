"""Height and overlaps for what is to be measured."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from workbench.studies.advice import TARGETS, Advice, Purpose, advise


def advised_overlaps(
    camera: str,
    purpose: str,
    stand_height: float,
    *,
    over_canopy: bool,
    highest: float | None = None,
    root: Path = Path(),
) -> tuple[dict[str, float], Advice]:
    """Options of :func:`workbench.planning.plan_mission` that the advice of the studies leads to.

    Parameters
    ----------
    camera, purpose, stand_height, highest, root
        As :func:`workbench.studies.advice.advise`.
    over_canopy
        Whether the surface that will be flown over is that of the canopy; otherwise it is the ground.

    Returns
    -------
    options : dict
        ``height``, ``forward_overlap`` and ``side_overlap``.
    advice : Advice
        With the evidence.
    """
    advice = advise(camera, stand_height, cast(Purpose, purpose), highest=highest, root=root)
    if over_canopy:
        height, forward, side = (
            advice.height - stand_height,
            advice.forward_overlap_canopy,
            TARGETS[purpose].side_overlap,
        )
    else:
        height, forward, side = advice.height, advice.forward_overlap, advice.side_overlap
    return {"height": height, "forward_overlap": forward, "side_overlap": side}, advice
