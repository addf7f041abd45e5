"""The crop mask: a mosaic without its outermost, weakly covered photographs."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import shapely

from workbench.errors import MosaicError
from workbench.params import MosaicParameters

_DEFAULTS = MosaicParameters()
_NEAR = 0.25  # Of the root of a polygon's area.


def crop_area(seamlines: gpd.GeoDataFrame, *, ratio: float = _DEFAULTS.crop_ratio) -> gpd.GeoDataFrame:
    """Area of a mosaic without the outermost seamline polygons [orthomosaic paper 2.5].

    A polygon is outermost if it touches the concave hull of all seamlines, or comes as near as a quarter
    of its own size: whether a seam or a bay of the outline lies a metre farther is chance. Where every
    polygon is, as in one strip or two, nothing would be left: the whole mosaic is kept and ``cropped``
    is False.

    Parameters
    ----------
    seamlines
        One polygon a photograph, as :func:`workbench.mosaic.seamline_polygons` gives them.
    ratio
        0..1, concavity of the hull.

    Returns
    -------
    GeoDataFrame
        One row: ``geometry``, ``photographs`` (how many are left) and ``cropped``.

    Raises
    ------
    MosaicError
        If there are no seamlines.
    """
    if seamlines.empty:
        raise MosaicError("No seamlines: the mosaic is empty, so there is nothing to crop.")
    whole = seamlines.union_all()
    rim = shapely.concave_hull(shapely.segmentize(whole, _step(whole)), ratio=ratio).boundary
    near = np.maximum(_NEAR * np.sqrt(seamlines.area), _step(whole))
    inside = seamlines[seamlines.distance(rim) > near]
    cropped = not inside.empty
    kept = inside if cropped else seamlines
    return gpd.GeoDataFrame(
        {"photographs": [len(kept)], "cropped": [cropped], "geometry": [kept.union_all()]},
        crs=seamlines.crs,
    )


def _step(area: shapely.Geometry) -> float:
    """Spacing of the vertices on the outline, a hundredth of its extent."""
    west, south, east, north = area.bounds
    return max(east - west, north - south) / 100
