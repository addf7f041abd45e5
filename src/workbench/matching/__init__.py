"""Dense matching: pairs, rectification, semi-global matching, from coarse to fine."""

from workbench.matching.engine import match_pair

__all__ = ["match_pair", "match_site"]


def __getattr__(name: str):
    # The stage pulls in the whole chain; a single pair needs none of it.
    if name == "match_site":
        from workbench.matching.stage import match_site

        return match_site
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
