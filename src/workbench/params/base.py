"""How a parameter is declared: default, unit, range and source in one place."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Section(BaseModel):
    """A section of ``params.yaml``: frozen, typed, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, strict=False)


def parameter(default: Any, description: str, *, unit: str, source: str, **limits: Any) -> Any:
    """Declare a parameter.

    Parameters
    ----------
    default
        Value where ``params.yaml`` is silent; a mutable one is copied.
    description
        One short sentence.
    unit
        Unit of the value, ``1`` for a number without one, ``-`` for a word or a switch.
    source
        Where the default comes from: a paper with its section, or the reasoning in a few words.
    limits
        ``ge``, ``gt``, ``le``, ``lt``, ``min_length`` ... of :func:`pydantic.Field`.
    """
    extra: dict[str, Any] = {"unit": unit, "source": source}
    return Field(default, description=description, json_schema_extra=extra, **limits)
