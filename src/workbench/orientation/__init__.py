"""Camera poses and tie points from photographs, positions and control points."""

from workbench.orientation.block import Block, OrientedPhotograph

__all__ = ["Block", "OrientedPhotograph", "orient_site", "predict_observation", "read_block"]


def __getattr__(name: str):
    # pycolmap takes a second to load; cameras and mosaics do without it.
    if name == "read_block":
        from workbench.orientation.files import read_block

        return read_block
    if name == "predict_observation":
        from workbench.orientation.predict import predict_observation

        return predict_observation
    if name == "orient_site":
        from workbench.orientation.stage import orient_site

        return orient_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
