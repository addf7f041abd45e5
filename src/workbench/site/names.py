"""Photographs by the names that other files give them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePosixPath


def find_photographs(wanted: Iterable[str], names: Iterable[str]) -> dict[str, str]:
    """Which photograph each name means: the same name, else one that differs in less than its stem.

    Folders, the ending and capital letters may differ (``C:\\photos\\IMG_1.JPG`` for ``IMG_1.tif``), as long
    as one photograph alone fits.

    Returns
    -------
    dict
        The names that mean exactly one photograph, each with the photograph's own name.

    Examples
    --------
    >>> find_photographs(["img_1.JPG", "IMG_9.jpg"], ["IMG_1.jpg", "IMG_2.jpg"])
    {'img_1.JPG': 'IMG_1.jpg'}
    """
    by_form: dict[str, set[str]] = {}
    for name in names:
        for form in (name, *_forms(name)):
            by_form.setdefault(form, set()).add(name)
    found = {}
    for word in wanted:
        owners = next((by_form[form] for form in (word, *_forms(word)) if form in by_form), set())
        if word in owners or len(owners) == 1:
            found[word] = word if word in owners else next(iter(owners))
    return found


def _forms(name: str) -> list[str]:
    """Ways to write a name, from the whole path to the stem."""
    path = PurePosixPath(name.replace("\\", "/").lower())
    return [str(path), str(path.parent / path.stem), path.name, path.stem]
