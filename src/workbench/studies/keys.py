"""Keys of computed steps: what a result depends on, as one short text."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any


def hash_of(content: Any) -> str:
    """Hash of anything that JSON can hold; other values enter by their text."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def hash_of_code(package: str, pattern: str = "*.py") -> str:
    """Hash of the source of a package of the workbench: results of other code are other results."""
    folder = Path(__file__).parents[1] / package
    digest = hashlib.sha256()
    for path in sorted(folder.rglob(pattern)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
