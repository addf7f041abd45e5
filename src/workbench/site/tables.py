"""Tables of text that people and devices write: separators, decimal commas, comments."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from workbench.errors import SiteError


def read_table(
    path: Path,
    needed: list[str],
    *,
    separator: str | None = None,
    header: bool = True,
    spaces: bool = False,
) -> list[tuple[int, dict[str, str]]]:
    """Rows by column name in small letters, with their line numbers.

    Separators may be semicolons, tabs or commas, and spaces where ``spaces`` allows; decimals may be
    commas where the separator is none. Lines that begin with # are comments, but for a header, which may
    follow other comments. Without a header the columns are called 1, 2, 3 ...

    Raises
    ------
    SiteError
        If the file is missing, no text, or lacks one of the needed columns.
    """
    lines = [(n, text) for n, text in enumerate(_read_lines(path), start=1) if text.strip()]
    if header and lines:
        place = _place_of_header([text for _, text in lines], needed, separator, spaces)
        first = lines[place][1].lstrip("# ")
        body = [line for line in lines[place + 1 :] if not line[1].lstrip().startswith("#")]
        sign = separator or _separator(first, spaces)
        names = [name.lower() for name in _cells(first, sign)]
    else:
        body = [line for line in lines if not line[1].lstrip().startswith("#")]
        first = body[0][1] if body else ""
        sign = separator or _separator(first, spaces)
        names = [str(n) for n in range(1, len(_cells(first, sign)) + 1)]
    lacking = [name for name in needed if name not in names]
    if lacking:
        raise SiteError(f"{path}: no column {', '.join(lacking)}. Its header is: {first or '(empty)'}")
    rows = []
    for number_of_line, text in body:
        cells = _cells(text, sign)
        if any(cells):
            cells += [""] * (len(names) - len(cells))
            rows.append((number_of_line, dict(zip(names, cells, strict=False))))
    return rows


def number(row: dict[str, str], key: str, path: Path, line: int, default: float | None = None) -> float:
    """Number in a cell, with a decimal point or comma.

    Raises
    ------
    SiteError
        If it is none (NaN and infinity are none either), or empty without a default.
    """
    text = row.get(key, "")
    if not text and default is not None:
        return default
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        text = text.replace(",", ".")
    if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
        raise SiteError(f"{path}, line {line}: {key} is '{text}', not a number.")
    return float(text)


def _place_of_header(texts: list[str], needed: list[str], separator: str | None, spaces: bool) -> int:
    """The first line that has the needed columns, of the comments at the top and the line after them."""
    plain = next((k for k, text in enumerate(texts) if not text.lstrip().startswith("#")), len(texts) - 1)
    for place, text in enumerate(texts[: plain + 1]):
        words = text.lstrip("# ")
        if set(needed) <= {name.lower() for name in _cells(words, separator or _separator(words, spaces))}:
            return place
    return plain


def _read_lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise SiteError(f"{path}: no such file.") from error
    except (UnicodeDecodeError, IsADirectoryError) as error:
        raise SiteError(f"{path}: not a text file in UTF-8 ({error}).") from error


def _separator(line: str, spaces: bool) -> str:
    for sign in (";", "\t", ","):
        if sign in line:
            return sign
    return " " if spaces else ","


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
