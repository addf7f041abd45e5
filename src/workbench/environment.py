"""The machine and the libraries that touch a number."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

LIBRARIES = (
    "workbench",
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "opencv-python-headless",
    "pycolmap",
    "pyceres",
    "scikit-image",
    "xarray",
    "rioxarray",
    "dask",
    "rasterio",
    "rio-cogeo",
    "pyproj",
    "shapely",
    "geopandas",
    "pyogrio",
    "exactextract",
    "cloth-simulation-filter",
    "laspy",
    "lazrs",
    "pandas",
    "pyarrow",
    "pillow",
    "pydantic",
    "matplotlib",
    "holoviews",
    "panel",
    "datashader",
    "dvc",
)


def describe_environment() -> dict[str, str]:
    """Versions of the libraries, Python, processor, memory and threads of this machine.

    Returns
    -------
    dict of str
        Label to value, in the order to print them; a library that is absent reads "not installed".
    """
    facts = {
        "system": platform.platform(),
        "python": platform.python_version(),
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "memory_gib": f"{psutil.virtual_memory().total / 2**30:.1f}",
        "threads_numba": os.environ.get("NUMBA_NUM_THREADS", "all cores"),
        "threads_openmp": os.environ.get("OMP_NUM_THREADS", "all cores"),
    }
    return facts | {library: _version(library) for library in LIBRARIES}


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
