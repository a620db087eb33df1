"""What a function or a record may be given, and records that are equal by value.

A name where an object is wanted, a text with a unit where a number is, one thing where a list is:
such a value is refused where it enters, with its place and what to give instead. Pydantic checks
functions (`checked`) and frozen dataclasses (`record`) by their annotations.
"""

from __future__ import annotations

import builtins
import importlib
import inspect
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache, cached_property, partial, wraps
from numbers import Integral, Real
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
)

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import ErrorDetails, SchemaValidator, core_schema

from energyplan import units
from energyplan.errors import InvalidInputError, UnusualValueWarning

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record")

SOURCES = {
    "BaseGeometry": "a polygon of shapely",
    "Battery": "Battery.preset(NAME)",
    "DriveLog": "DriveLog.read(FILE)",
    "EnergyCost": "EnergyCost(model)",
    "HeightMap": "read_heights(FILE)",
    "Line": "live.follow(FILE)",
    "Mission": "read_mission(FILE)",
    "Motion": "Motion.from_twist(v, omega, icr)",
    "OccupancyGrid": "read_map(FILE)",
    "Path": "Path.from_poses(poses), or the path of a plan",
    "PlanningProblem": "PlanningProblem(map, cost, start, goal)",
    "PowerModel": "PowerModel.preset(NAME), read_model(FILE), or the model of an identification",
    "Site": "Site(map)",
    "SurfaceMap": "read_surfaces(FILE)",
    "Trajectory": "profile(path, model), or the trajectory of a plan's drive",
    "TreadICR": "TreadICR.symmetric(METRES)",
    "Vehicle": "Vehicle.preset(NAME) or read_vehicle(FILE)",
}
"""Where objects come from, for messages."""

_TEXT = 60  # characters of a value that a message shows
_LONG = 10**_TEXT

NO_NUMBER = (TypeError, ValueError, OverflowError)
"""What converting a cell or a value to a number may raise: of another kind, no number, too long."""


def described(value: object) -> str:
    """Return a value in words, short enough for a message."""
    if isinstance(value, Integral) and not -_LONG < value < _LONG:
        return f"a whole number of more than {_TEXT} digits"
    if value is None or isinstance(value, bool | Real):
        return f"{value}"
    if isinstance(value, str):
        shown = value if len(value) <= _TEXT else f"{value[:_TEXT]}..."
        return f"the text {shown!r}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape}"
    if isinstance(value, list | tuple | dict) and len(repr(value)) <= _TEXT:
        return repr(value)
    name = type(value).__name__
    return f"a{'n' if name[0] in 'AEIOU' else ''} {name}"


def numbers(
    value: ArrayLike,
    name: str,
    error: type[Exception] = InvalidInputError,
    *,
    last: int | None = None,
    words: str = "numbers",
) -> NDArray[np.float64]:
    """Return numbers as an array of floats."""
    try:
        if isinstance(value, list | tuple) and any(isinstance(part, bool) for part in value):
            raise TypeError
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":  # masks are arrays of truth
            raise TypeError
        array = array.astype(float, copy=False)
    except NO_NUMBER:
        raise error(f"{name} is {described(value)}; give {words}") from None
    if last is not None and (not array.ndim or array.shape[-1] != last):
        raise error(f"{name} has shape {array.shape}; give {words} along the last axis")
    return array


# -- sizes of values ------------------------------------------------------------------------------


class ImpossibleError(ValueError):
    """A number is not possible."""

    def __init__(self, message: str, value: Any, place: tuple[int, ...]) -> None:
        super().__init__(message)
        self.value, self.place = value, place  # the number, and where it stands in its array


@dataclass(frozen=True)
class Within:
    """What a number may be, and what it usually is, beyond which it is refused, or doubted."""

    possible: tuple[float, float]  # least and greatest number that is not refused
    typical: tuple[float, float]  # least and greatest number without a warning
    unit: str = ""
    slip: str = ""  # which mistake a number that is too large shows
    endless: bool = False  # whether an infinite number stands for no limit

    def range(self, ends: tuple[float, float]) -> str:
        """Return least and greatest in words."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{ends[0]:.6g} to {ends[1]:.6g}{unit}"

    def _beyond(self, ends: tuple[float, float], value: ArrayLike) -> tuple[tuple[int, ...], str]:
        """Return the place of the first number beyond some ends, and what it should be."""
        given = np.asarray(value, float)
        limitless = self.endless & np.isinf(given) & ((given > 0) | (ends[0] < 0))
        good = (given >= ends[0]) & (given <= ends[1]) | limitless
        if good.all():
            return (), ""
        at = tuple(int(k) for k in np.argwhere(~good)[0])
        slip = f" ({self.slip})" if self.slip and given[at] > ends[1] else ""
        return at, f"{self.range(ends)}{slip}"

    def unusual(self, value: ArrayLike) -> tuple[tuple[int, ...], str]:
        """Return where an unusual number stands and why it is one; no text if there is none."""
        at, wanted = self._beyond(self.typical, value)
        if not wanted:
            return at, ""
        shown = f"{np.asarray(value)[at]:.6g}"
        return at, f"{shown} is unusual; usual is {wanted}; check the number and its unit"

    def _possible(self, value: Any) -> Any:
        if value is not None and not isinstance(value, str):
            try:
                at, wanted = self._beyond(self.possible, value)
            except OverflowError:  # more digits than a float has
                text = f"give {self.range(self.possible)}"
                raise ImpossibleError(text, described(value), ()) from None
            if wanted:
                raise ImpossibleError(f"give {wanted}", _item(np.asarray(value)[at]), at)
        return value

    def __get_pydantic_core_schema__(
        self, source: Any, handler: Callable[[Any], core_schema.CoreSchema]
    ) -> core_schema.CoreSchema:
        return self.around(handler(source))

    def around(self, schema: core_schema.CoreSchema) -> core_schema.CoreSchema:
        """Have pydantic refuse what is not possible."""
        return core_schema.no_info_after_validator_function(self._possible, schema)


Doubts = Iterator[tuple[tuple[str | int, ...], str]]
"""Places of unusual values, and what is unusual there."""


@cache
def bounds(owner: Callable[..., Any]) -> dict[str, Within]:
    """Return the sizes of the fields of a record, or of the parameters of a function."""
    return {
        name: part
        for name, hint in _hints(owner).items()
        for part in _parts_of(hint)
        if isinstance(part, Within)
    }


def _parts_of(hint: Any) -> Iterator[Any]:
    """Yield an annotation and its parts."""
    yield hint
    for part in get_args(hint):
        yield from _parts_of(part)


def doubts(owner: Callable[..., Any], values: Mapping[str, Any]) -> Doubts:
    """Yield the values that the fields or parameters of an owner do not usually have."""
    for name, within in bounds(owner).items():
        value = values.get(name)
        if value is not None and not isinstance(value, str):
            at, text = within.unusual(value)
            if text:
                yield (name, *at), text


def doubts_of(record: Any, place: tuple[str | int, ...] = ()) -> Doubts:
    """Yield the unusual values of a record, and of the records and lists of them that it holds."""
    if isinstance(record, tuple):
        for k, item in enumerate(record):
            yield from doubts_of(item, (*place, k))
    elif is_dataclass(record) and (kind := type(record)) and bounds(kind):  # type: ignore[arg-type]
        held = vars(record)
        for at, text in doubts(kind, held):
            yield (*place, *at), text
        for name, value in held.items():
            yield from doubts_of(value, (*place, name))


def unusual(record: Any, name: str) -> list[str]:
    """Return the unusual values of a record in words."""
    return [f"{in_words(place)}: {text}" for place, text in doubts_of(record, (name,))]


def in_words(place: Iterable[str | int]) -> str:
    """Return where a value stands, as ``tasks.2.power``."""
    return ".".join(map(str, place))


def warn(text: str, stacklevel: int = 2) -> None:
    """Warn of a value that is possible but unusual."""
    warnings.warn(text, UnusualValueWarning, stacklevel=stacklevel + 1)


# -- kinds of values ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Kind:
    """A kind of values: what to give, and how pydantic checks it."""

    words: str
    schema: core_schema.CoreSchema

    @cached_property
    def _validator(self) -> SchemaValidator:
        return SchemaValidator(self.schema)

    def check(self, value: object, name: str, error: type[Exception], whose: str = "") -> None:
        """Refuse a value of another kind, or one that is not possible, with its place."""
        try:
            self._validator.validate_python(value)
        except ValidationError as problem:
            # of a choice of kinds the one that stands there: what is wrong lies deepest in it
            places = [
                (len(at := [k for k in one["loc"] if isinstance(k, int)]), "ctx" in one, one, at)
                for one in problem.errors(include_url=False)
            ]
            depth, _, first, at = max(places, key=lambda found: found[:2])
            words = "" if depth else f"give {self.words}"
            raise _refusal(first, (name, *at), error, whose, words) from None


def _refusal(
    found: ErrorDetails, place: tuple[Any, ...], error: type[Exception], whose: str, words: str = ""
) -> Exception:
    """Return the error for what pydantic found at a place."""
    message, item = words or found["msg"].removeprefix("Value error, "), found["input"]
    own = found.get("ctx", {}).get("error")
    if isinstance(own, ImpossibleError):
        message, place = str(own), (*place, *own.place)
        item = own.value if own.place else item
    where = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in place)[1:]
    said = "" if found["type"] == "missing" else f" is {described(item)}"
    mark = ";" if message.startswith("give") else ":"
    refused = error(f"{whose}{where}{said}{mark} {message}")
    if isinstance(refused, InvalidInputError):
        refused.place = place
    return refused


class _Fits(NamedTuple):
    """Has pydantic take what fits."""

    words: str
    fits: Callable[[Any], bool]
    read: Callable[[Any], Any] = lambda value: value

    def take(self, value: Any, info: ValidationInfo) -> Any:
        """Return the value; the text of a file may be a number, such as 010."""
        if self.fits is _number and info.context is not None:
            value = amount("number", value)
        if not self.fits(value):
            raise ValueError(f"give {self.words}")
        return self.read(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(self.take)


def _of_kind(words: str, fits: Callable[[Any], bool]) -> _Kind:
    """Return the kind of the values that fit."""
    return _Kind(words, _Fits(words, fits).__get_pydantic_core_schema__(Any, None))


def _item(value: Any) -> Any:
    """Return a number of NumPy as Python's, so that it is shown and saved as one."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value


def _array(value: Any) -> NDArray[np.float64]:
    array = np.array(value, float)
    array.setflags(write=False)
    return array


def _number(value: Any) -> bool:
    if isinstance(value, Integral) and not -_LONG < value < _LONG:
        return False
    if isinstance(value, Real):
        return not isinstance(value, bool)
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"


def _whole(value: Any) -> bool:
    return _number(value) and (isinstance(value, Integral) or float(value).is_integer())


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _numeric(value: Any) -> bool:
    with suppress(InvalidInputError):
        numbers(value, "value")
        return True
    return False


def _column(value: Any) -> bool:
    return (
        _numeric(value)
        and np.ndim(value) == 1
        and len(value) > 0
        and bool(np.isfinite(_array(value)).all())
    )


def _several(value: object) -> bool:
    named = isinstance(value, str | bytes) or hasattr(value, "keys")  # mappings, tables
    return isinstance(value, Iterable) and not named


_NUMBERS = _of_kind("numbers", _numeric)
_PLAIN: dict[Any, _Kind] = {
    float: _of_kind("a number, in SI units", _number),
    int: _of_kind("a whole number", _whole),
    bool: _of_kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: _of_kind("a text", _text),
    type(None): _of_kind("", lambda value: value is None),
    NDArray[np.float64]: _NUMBERS,
}


def _of_class(wanted: type) -> _Kind | None:
    name = wanted.__name__
    if issubclass(wanted, Path):
        return _of_kind("the name of a file", lambda value: isinstance(value, os.PathLike))
    if wanted.__module__.partition(".")[0] != "energyplan" or name == "Pose":
        return None
    source = f": {SOURCES[name]}" if name in SOURCES else ""
    article = "an" if name[0] in "AEIOU" else "a"
    return _of_kind(f"{article} {name}{source}", lambda value: isinstance(value, wanted))


def _list_of(items: _Kind | None) -> _Kind:
    """Return the kind of lists, and of what else yields such items one after the other."""
    words = f"a list: {items.words}, ..." if items else "a list"

    def check(value: Any, within: core_schema.ValidatorFunctionWrapHandler) -> Any:
        if not _several(value):
            raise ValueError(f"give {words}")
        if items and isinstance(value, list | tuple):
            within([*value])
        return value

    held = core_schema.list_schema(items.schema if items else None)
    return _Kind(words, core_schema.no_info_wrap_validator_function(check, held))


@cache
def _kind(hint: Any) -> _Kind | None:
    """Return the kind that an annotation means; None where anything may be given."""
    if hint in _PLAIN:
        return _PLAIN[hint]
    outer, parts = get_origin(hint), get_args(hint)
    if outer is Annotated:
        kind = _kind(hint.__origin__) or _Kind("", core_schema.any_schema())
        schema = kind.schema
        for part in hint.__metadata__:
            schema = part.around(schema) if isinstance(part, Within) else schema
        return _Kind(kind.words, schema)
    if outer in (Union, UnionType):
        return _either(parts)
    if outer is Literal:
        words = " or ".join(map(repr, parts))
        return _of_kind(words, lambda value: isinstance(value, str) and value in parts)
    if outer in (Sequence, tuple, list, Iterable):
        return _list_of(_kind(parts[0]) if len({*parts} - {...}) == 1 else None)  # of one kind
    if outer in (Mapping, dict):
        return _of_kind("a mapping", lambda value: isinstance(value, Mapping))
    if outer is Callable:
        return _of_kind("a function", callable)
    return _of_class(hint) if isinstance(hint, type) else None


def _either(parts: tuple[Any, ...]) -> _Kind | None:
    """Return the kind of one of several annotations; `ArrayLike` is several by itself."""
    arrays = {*get_args(ArrayLike)} if {*get_args(ArrayLike)} <= {*parts} else set()
    kinds = [_NUMBERS] if arrays else []
    for part in parts:
        if part not in arrays:
            if (kind := _kind(part)) is None:
                return None
            kinds.append(kind)
    words = " or ".join(kind.words for kind in kinds if kind.words)
    return _Kind(words, core_schema.union_schema([kind.schema for kind in kinds]))


class _Names(dict[str, Any]):
    """The names of a module, then those of the library."""

    def __missing__(self, name: str) -> Any:
        if not name.startswith("_") and not hasattr(builtins, name):
            with suppress(AttributeError):
                return getattr(importlib.import_module("energyplan"), name)
        raise KeyError(name)


@cache
def _hints(owner: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of the parameters of a function, or of the fields of a dataclass."""
    found: dict[str, Any] = {}
    for part in reversed(owner.__mro__[:-1]) if isinstance(owner, type) else [owner]:
        names = _Names(vars(importlib.import_module(part.__module__)))
        for name, text in inspect.get_annotations(part).items():
            with suppress(NameError):  # what only type checkers know
                found[name] = eval(text, {}, names) if isinstance(text, str) else text
    return found


@cache
def _kinds(owner: Callable[..., Any]) -> dict[str, _Kind]:
    """Return the kinds of the parameters of a function, or of the fields of a dataclass."""
    # of a choice among names alone the function says which it knows
    found = {
        name: None if get_origin(hint) is Literal else _kind(hint)
        for name, hint in _hints(owner).items()
        if name != "return"
    }
    if isinstance(owner, type):
        built = {field.name for field in fields(owner) if field.init}
        found = {name: kind for name, kind in found.items() if name in built}
    return {name: kind for name, kind in found.items() if kind is not None}


def wanted_words(wanted: type) -> str:
    """Return what to give where an instance of a class is wanted."""
    kind = _of_class(wanted)
    return kind.words if kind else SOURCES.get(wanted.__name__, f"a {wanted.__name__}")


def instance(
    value: object, wanted: type, name: str, error: type[Exception] = InvalidInputError
) -> None:
    """Check that a value is of a class: quick, for what is called by the million."""
    if not isinstance(value, wanted):
        raise error(f"{name} is {described(value)}; give {wanted_words(wanted)}")


def check_fields(record: Any, error: type[Exception], whose: str = "") -> None:
    """Check a dataclass's fields against their annotations, where it is built."""
    for name, kind in _kinds(type(record)).items():  # type: ignore[arg-type]
        value = getattr(record, name)
        kind.check(value, name, error, whose)
        if (plain := _item(value)) is not value:
            object.__setattr__(record, name, plain)


def checked(error: type[Exception] = InvalidInputError) -> Callable[[Function], Function]:
    """Decorate a function so that its arguments are checked; it warns of unusual ones."""

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)

        @wraps(function)
        def held(*args: Any, **options: Any) -> Any:
            try:
                given = signature.bind(*args, **options).arguments
            except TypeError:
                given = {}  # the call below says in Python's own words what is wrong
            for name, kind in _kinds(function).items():
                if name in given:
                    several = signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
                    for key, value in given[name].items() if several else ((name, given[name]),):
                        kind.check(value, key, error)
            for place, text in doubts(function, given):
                warn(f"{place[0]}: {text}")
            return function(*args, **options)

        return held  # type: ignore[return-value]

    return decorate


# -- equality -------------------------------------------------------------------------------------


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
    """Base of frozen dataclasses with arrays or mappings: nobody can write to those of a copy."""

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
    "length": units.LENGTH,
    "time": units.TIME,
    "power": units.POWER,
    "charge": {"C": 1.0, **units.CHARGE},
    "resistance": {"ohm": 1.0, "mohm": 1e-3},
    "voltage": units.VOLTAGE,
    "current": units.CURRENT,
    "energy": units.ENERGY,
    "mass": units.MASS,
    "mass per length": {"kg/m": 1.0, "g/m": 1e-3},
    "fraction": {"%": 0.01},
    "speed": units.SPEED,
    "temperature": {**units.TEMPERATURE, "°C": 1.0, "C": 1.0},
    "angle": units.ANGLE,
}
_BARE = {"charge": (1000.0, "Ah")}
"""Below how much a plain number is doubted, and the unit that was meant: no robot has so little."""
_AMOUNT = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z/%°µμ]*)\s*")


def amount(kind: str, value: Any, doubted: bool = True) -> Any:
    """Read ``5 min``, ``20 %`` or a plain number in SI units."""
    unit, known = "", UNITS[kind]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) and value != "inf":
        found = _AMOUNT.fullmatch(value)
        if found is None:
            raise ValueError("give a number" + (f", in {', '.join(known)}" if known else ""))
        value, given = float(found[1]), found[2]
        unit = units.standard(given, known) or ""
        if given and not unit:
            plain = next((name for name, factor in known.items() if factor == 1.0), "SI")
            raise ValueError(
                f"the unit of a {kind} is one of {', '.join(known)}, or none for {plain}"
            )
    if isinstance(value, bool):
        raise ValueError("give a number")
    least, meant = _BARE.get(kind, (0.0, ""))
    if doubted and not unit and isinstance(value, int | float) and 0.0 < value < least:
        raise ValueError(
            f"{value:g} has no unit, and would be {next(iter(known))}; write {value:g} {meant}"
        )
    return value * known[unit] + units.OFFSETS.get(unit, 0.0) if unit else value


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
Finite = Annotated[float, amount_of("number"), Field(allow_inf_nan=False)]
Celsius = Annotated[float, amount_of("temperature"), Field(allow_inf_nan=False)]
ABOVE, FROM = Field(gt=0), Field(ge=0)


def instance_of(*wanted: type) -> _Fits:
    """Take an instance of one of some classes, or nothing where that is allowed."""
    return _Fits(wanted_words(wanted[0]), lambda value: isinstance(value, wanted))


Scalar = Annotated[float, _Fits("a number, in SI units", _number, _item)]
Text = Annotated[str, _Fits("a text", _text)]
Array = Annotated[NDArray[np.float64], _Fits("numbers", _numeric, _array)]
Numbers = Annotated[NDArray[np.float64], _Fits("a list of finite numbers", _column, _array)]

# -- one type for a file, a request and Python -----------------------------------------------------


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def record(
    error: type[InvalidInputError], *, eq: bool = True, whose: str | None = None
) -> Callable[[type[Record]], type[Record]]:
    """Make a class a frozen dataclass that is checked alike from a file, a request and Python."""

    def decorate(cls: type[Record]) -> type[Record]:
        name = f"{cls.__name__.lower()}: " if whose is None else whose
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
                words = "give a list" if first["type"] == "tuple_type" else ""
                raise _refusal(first, tuple(place), error, name, words) from None

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
