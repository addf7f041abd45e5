"""Surfaces from matched pairs: gridding, fusion, count, terrain, smoothing."""

from workbench.surface.fusion import fuse_downscales, fuse_pairs
from workbench.surface.smoothing import bilateral

__all__ = ["bilateral", "fuse_downscales", "fuse_pairs", "surface_site"]


def __getattr__(name: str):
    # The stage pulls in the whole chain; a filter in a notebook does not need it.
    if name == "surface_site":
        from workbench.surface.stage import surface_site

        return surface_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
