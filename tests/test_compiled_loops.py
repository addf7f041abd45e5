"""Machine code kept on disk is that of the present sources, also of those that are compiled into it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CALLER = """
from workbench.compiled import compiled
from loops.callee import part

@compiled()
def total(n):
    s = 0.0
    for k in range(n):
        s += part(k)
    return s

print(total(3), sum(total.stats.cache_hits.values()))
"""
CALLEE = "import numba\n\n@numba.njit\ndef part(k):\n    return {} * k\n"


def run(folder: Path) -> tuple[float, int]:
    done = subprocess.run(
        [sys.executable, "-B", "-m", "loops.caller"], cwd=folder, capture_output=True, text=True, check=True
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_a_change_in_a_called_file_is_noticed(tmp_path):
    package = tmp_path / "loops"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(CALLER, encoding="utf-8")
    (package / "callee.py").write_text(CALLEE.format(1), encoding="utf-8")
    assert run(tmp_path) == (3.0, 0)
    assert run(tmp_path) == (3.0, 1)
    (package / "callee.py").write_text(CALLEE.format(5), encoding="utf-8")
    assert run(tmp_path) == (15.0, 0)
