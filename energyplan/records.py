"""Records: frozen dataclasses with arrays or mappings, equal by value and read-only in copies."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, fields
from functools import partial, wraps
from math import radians
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from energyplan.errors import InvalidInputError
from energyplan.kinds import NO_NUMBER, described, wanted_words


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
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if type(one) is not type(other):
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, partial) and isinstance(other, partial):
        return _same(_parts(one), _parts(other))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)


def _key(value: object) -> object:
    if isinstance(value, np.ndarray):
        plain = value if value.dtype.kind == "b" else value + 0.0  # of -0 as of 0
        return value.shape, plain.tobytes()
    if isinstance(value, Mapping):
        return frozenset((name, _key(item)) for name, item in value.items())
    if isinstance(value, partial):
        value = _parts(value)
    return tuple(map(_key, value)) if isinstance(value, tuple) else value


def _parts(function: partial[Any]) -> tuple[Any, ...]:
    return function.func, function.args, function.keywords


def _compared(record: Any) -> Iterator[Any]:
    return (getattr(record, field.name) for field in fields(record) if field.compare)


class ByValue(ReadOnly):
    """Base of dataclasses with arrays among their fields: equal where all fields are.

    Declare them with ``eq=False``: what `dataclass` writes cannot compare arrays. The hash is
    worked out once; another process has another one.
    """

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "_hash"}

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self is other or all(map(_same, _compared(self), _compared(other)))

    def __hash__(self) -> int:
        known = vars(self).get("_hash")
        if known is None:
            known = vars(self)["_hash"] = hash(tuple(map(_key, _compared(self))))
        return int(known)

    def bare(self) -> Any:
        """Return a copy that has its fields, and nothing of what was worked out from them."""
        other = object.__new__(type(self))
        for part in fields(self):  # type: ignore[arg-type]
            value = getattr(self, part.name)
            vars(other)[part.name] = value.bare() if isinstance(value, ByValue) else value
        return other


# -- units ---------------------------------------------------------------------------------------

UNITS: dict[str, dict[str, float]] = {
    "number": {},
    "length": {"m": 1.0, "cm": 0.01, "mm": 1e-3},
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0},
    "power": {"W": 1.0, "kW": 1e3},
    "charge": {"C": 1.0, "Ah": 3600.0, "mAh": 3.6},
    "resistance": {"ohm": 1.0, "mohm": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "energy": {"J": 1.0, "Wh": 3600.0, "kWh": 3.6e6},
    "mass": {"kg": 1.0, "g": 1e-3},
    "fraction": {"%": 0.01},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6},
    "temperature": {"C": 1.0},
    "angle": {"rad": 1.0, "deg": radians(1.0)},
}
_BARE = {"charge": (1000.0, "Ah")}
"""Below how much a plain number is doubted, and the unit that was meant: no robot has so little."""
_AMOUNT = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z/%]*)\s*")


def amount(kind: str, value: Any, doubted: bool = True) -> Any:
    """Read ``5 min``, ``20 %`` or a plain number in SI units."""
    unit, units = "", UNITS[kind]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) and value != "inf":
        found = _AMOUNT.fullmatch(value)
        if found is None:
            raise ValueError("give a number" + (f", in {', '.join(units)}" if units else ""))
        value, unit = float(found[1]), found[2]
        if unit and unit not in units:
            raise ValueError(f"the unit of a {kind} is one of {', '.join(units)}, or none for SI")
    if isinstance(value, bool):
        raise ValueError("give a number")
    least, meant = _BARE.get(kind, (0.0, ""))
    if doubted and not unit and isinstance(value, int | float) and 0.0 < value < least:
        raise ValueError(
            f"{value:g} has no unit, and would be {next(iter(units))}; write {value:g} {meant}"
        )
    return value * units[unit] if unit else value


def amount_of(kind: str) -> BeforeValidator:
    """Read a number that may carry a unit of a kind; what Python gives is in SI units."""
    return BeforeValidator(
        lambda value, info: amount(kind, value, doubted=info.context is not None)
    )


Number = Annotated[float, amount_of("number")]
Time = Annotated[float, amount_of("time")]
Power = Annotated[float, amount_of("power")]
Mass = Annotated[float, amount_of("mass")]
Length = Annotated[float, amount_of("length")]
Fraction = Annotated[float, amount_of("fraction")]
Amps = Annotated[float, amount_of("current")]
Volts = Annotated[float, amount_of("voltage")]
Ohms = Annotated[float, amount_of("resistance")]
Coulombs = Annotated[float, amount_of("charge")]
Celsius = Annotated[float, amount_of("temperature"), Field(allow_inf_nan=False)]
ABOVE, FROM = Field(gt=0), Field(ge=0)
FINITE = Field(ge=0, allow_inf_nan=False)


def instance_of(*wanted: type) -> PlainValidator:
    """Take an instance of one of some classes, or nothing where that is allowed."""

    def check(value: Any) -> Any:
        if not isinstance(value, wanted):
            raise ValueError(f"give {wanted_words(wanted[0])}")
        return value

    return PlainValidator(check)


def _column(value: Any) -> NDArray[np.float64]:
    try:
        array = np.array(value, float)
    except NO_NUMBER:
        array = np.zeros(0)
    if array.ndim != 1 or not len(array) or not np.all(np.isfinite(array)):
        raise ValueError("give a list of finite numbers")
    array.setflags(write=False)
    return array


Numbers = Annotated[NDArray[np.float64], PlainValidator(_column)]

# -- one type for a file, a request and Python -----------------------------------------------------

Record = TypeVar("Record")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def record(
    error: type[InvalidInputError], *, eq: bool = True
) -> Callable[[type[Record]], type[Record]]:
    """Make a class a frozen dataclass that is checked alike from a file, a request and Python."""

    def decorate(cls: type[Record]) -> type[Record]:
        config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
        made: Any = pydantic.dataclasses.dataclass(frozen=True, eq=eq, config=config)(cls)
        build = made.__init__

        @wraps(build)
        def checked(self: Any, *values: Any, **named: Any) -> None:
            try:
                build(self, *values, **named)
            except ValidationError as problem:
                first = problem.errors(include_url=False)[0]
                if isinstance(own := first.get("ctx", {}).get("error"), error):
                    raise own from None
                place = list(first["loc"])
                if place and isinstance(place[0], int):  # of a value without its name
                    place[0] = fields(made)[place[0]].name
                message = first["msg"].removeprefix("Value error, ")
                if first["type"] == "tuple_type":
                    message = "give a list"
                value = ".".join(map(str, place))
                if first["type"] != "missing":
                    value += f" is {described(first['input'])}"
                raise error(f"{cls.__name__.lower()}: {value}: {message}", place) from None

        made.__init__ = checked
        return made  # type: ignore[no-any-return]

    return decorate


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
