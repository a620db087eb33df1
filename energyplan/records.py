"""Records: frozen dataclasses with arrays or mappings, equal by value and read-only in copies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, ValidationInfo, field_validator


def _plain(value: Any) -> Any:
    """Return a value with dictionaries for read-only mappings, which nothing can copy."""
    if isinstance(value, MappingProxyType):
        return {name: _plain(item) for name, item in value.items()}
    return value


def _read_only(value: Any) -> Any:
    """Return a value that nobody can write to, if it is an array or a dictionary."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.view()  # whoever gave the array may still write to it
        value.setflags(write=False)
    if isinstance(value, dict):
        return MappingProxyType({name: _read_only(item) for name, item in value.items()})
    return value


class ReadOnly:
    """Base of frozen dataclasses with arrays or mappings: nobody can write to those of a copy.

    Pickles and deep copies forget that an array is read-only, and refuse read-only mappings.
    """

    def __getstate__(self) -> dict[str, Any]:
        return {name: _plain(value) for name, value in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        named = {field.name for field in fields(self)}  # type: ignore[arg-type]
        for name, value in state.items():
            kept = name in named or isinstance(value, np.ndarray)
            vars(self)[name] = _read_only(value) if kept else value


# -- equality -------------------------------------------------------------------------------------


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if type(one) is not type(other):
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)


def _key(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.shape, (value + 0.0).tobytes()  # of -0 as of 0
    if isinstance(value, Mapping):
        return frozenset((name, _key(item)) for name, item in value.items())
    return tuple(map(_key, value)) if isinstance(value, tuple) else value


def _compared(record: Any) -> Iterator[Any]:
    return (getattr(record, field.name) for field in fields(record) if field.compare)


class ByValue(ReadOnly):
    """Base of dataclasses with arrays among their fields: equal where all fields are.

    Declare them with ``eq=False``: what `dataclass` writes cannot compare arrays.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(map(_same, _compared(self), _compared(other)))

    def __hash__(self) -> int:
        return hash(tuple(map(_key, _compared(self))))


# -- files -----------------------------------------------------------------------------------------


class Checked(BaseModel):
    """What a mapping holds: no number is written as true or false."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth(cls, value: Any, info: ValidationInfo) -> Any:
        parts = value if isinstance(value, list) else [value]
        kind = cls.model_fields[info.field_name or ""].annotation
        allowed = kind in (Any, bool) or bool in get_args(kind)
        if not allowed and any(isinstance(part, bool) for part in parts):
            raise ValueError("Input should be a number or a text")
        return value
