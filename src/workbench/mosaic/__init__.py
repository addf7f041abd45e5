"""True orthophotos: visibility, best view, seamlines, colour balance, crop mask."""

from workbench.mosaic.crop import crop_area
from workbench.mosaic.mesh import mesh_surface
from workbench.mosaic.orthophoto import Orthophoto, make_orthophoto
from workbench.mosaic.seams import seamline_polygons

__all__ = ["Orthophoto", "crop_area", "make_orthophoto", "mesh_surface", "mosaic_site", "seamline_polygons"]


def __getattr__(name: str):
    # The stage pulls in the whole chain; the pure functions above do not need it.
    if name == "mosaic_site":
        from workbench.mosaic.stage import mosaic_site

        return mosaic_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
