"""From overlapping aerial photographs to surfaces, orthophotos, reed and tree measurements."""

from importlib.metadata import version

__version__ = version("workbench")
