"""What a function or a dataclass may be given, read from its annotations.

A name where an object is wanted, a text with a unit where a number is, one thing where a list is:
such a value is refused where it enters, with what to give instead. Further in it would fail with
an error that says nothing to whoever gave it.
"""

from __future__ import annotations

import builtins
import importlib
import inspect
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic_core import core_schema

from energyplan.errors import InvalidInputError, UnusualValueWarning

Function = TypeVar("Function", bound=Callable[..., Any])

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
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError
        array = array.astype(float, copy=False)
    except NO_NUMBER:
        raise error(f"{name} is {described(value)}; give {words}") from None
    if last is not None and (not array.ndim or array.shape[-1] != last):
        raise error(f"{name} has shape {array.shape}; give {words} along the last axis")
    return array


# -- sizes of values ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Within:
    """What a number may be, and what it usually is; stands beside a field, in its annotation.

    What is not possible is refused, what is possible but not usual is accepted with a warning.
    """

    possible: tuple[float, float]  # least and greatest number that is not refused
    usual: tuple[float, float]  # least and greatest number without a warning
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

    def fault(self, value: ArrayLike) -> tuple[tuple[int, ...], str]:
        """Return where an impossible number stands and what to give; no text if there is none."""
        at, wanted = self._beyond(self.possible, value)
        return at, f"give {wanted}" if wanted else ""

    def doubt(self, value: ArrayLike) -> tuple[tuple[int, ...], str]:
        """Return where an unusual number stands and why it is one; no text if there is none."""
        at, wanted = self._beyond(self.usual, value)
        return at, f"usual is {wanted}; check the number and its unit" if wanted else ""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: Callable[[Any], core_schema.CoreSchema]
    ) -> core_schema.CoreSchema:
        """Have pydantic refuse what is not possible."""

        def possible(value: Any) -> Any:
            if wanted := self.fault(value)[1]:
                raise ValueError(wanted)
            return value

        return core_schema.no_info_after_validator_function(possible, handler(source))


Doubts = Iterator[tuple[tuple[str | int, ...], str]]
"""Places of unusual values, and what is unusual there."""


@cache
def bounds(owner: Callable[..., Any]) -> dict[str, Within]:
    """Return the sizes of the fields of a record, or of the parameters of a function."""
    return {
        name: part
        for name, hint in _hints(owner).items()
        for part in _parts(hint)
        if isinstance(part, Within)
    }


def _parts(hint: Any) -> Iterator[Any]:
    """Yield an annotation, and all that it is made of."""
    yield hint
    for part in get_args(hint):
        yield from _parts(part)


def check_sizes(
    owner: Callable[..., Any], values: Mapping[str, Any], error: type[Exception],
    whose: str = "",
) -> None:  # fmt: skip
    """Refuse values that the fields or parameters of an owner cannot have."""
    for name, within in bounds(owner).items():
        value = values.get(name)
        if value is not None and not isinstance(value, str):
            at, wanted = within.fault(value)
            if wanted:
                item = "".join(f"[{k}]" for k in at)
                shown = described(np.asarray(value)[at].item())
                problem = error(f"{whose}{name}{item} is {shown}; {wanted}")
                if isinstance(problem, InvalidInputError):
                    problem.place = (name, *at)
                raise problem


def doubts(owner: Callable[..., Any], values: Mapping[str, Any]) -> Doubts:
    """Yield the values that the fields or parameters of an owner do not usually have."""
    for name, within in bounds(owner).items():
        value = values.get(name)
        if value is not None and not isinstance(value, str):
            at, wanted = within.doubt(value)
            if wanted:
                yield (name, *at), f"{np.asarray(value)[at]:.6g} is unusual; {wanted}"


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


def in_words(place: tuple[str | int, ...]) -> str:
    """Return where a value stands, as ``tasks.2.power``."""
    return ".".join(map(str, place))


def warn(text: str, stacklevel: int = 2) -> None:
    """Warn of a value that is possible but not usual."""
    warnings.warn(text, UnusualValueWarning, stacklevel=stacklevel + 1)


# -- kinds of values ------------------------------------------------------------------------------


class _Kind(NamedTuple):
    """A kind of values: what to give, what it takes, and of what kind its items are."""

    words: str
    fits: Callable[[object], bool] = lambda value: True
    items: _Kind | None = None
    others: tuple[_Kind, ...] = ()  # where it is one of several kinds

    def fault(self, value: object, place: str) -> str:
        """Return what is wrong with a value of another kind; empty where nothing is."""
        faults = [kind.fault(value, place) for kind in self.others]
        if "" in faults:
            return ""
        if faults or not self.fits(value):
            within = (fault for fault in faults if fault.startswith(f"{place}["))
            return next(within, f"{place} is {described(value)}; give {self.words}")
        if self.items is None or not isinstance(value, list | tuple):
            return ""
        faults = [self.items.fault(item, f"{place}[{k}]") for k, item in enumerate(value)]
        return next(filter(None, faults), "")


def _number(value: object) -> bool:
    if isinstance(value, Integral) and not -_LONG < value < _LONG:
        return False
    if isinstance(value, Real):
        return not isinstance(value, bool)
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"


def _whole(value: object) -> bool:
    return _number(value) and (isinstance(value, Integral) or float(value).is_integer())  # type: ignore[arg-type]


def _numeric(value: object) -> bool:
    with suppress(InvalidInputError):
        numbers(value, "value")  # type: ignore[arg-type]
        return True
    return False


def _several(value: object) -> bool:
    named = isinstance(value, str | bytes) or hasattr(value, "keys")  # mappings, tables
    return isinstance(value, Iterable) and not named


_NUMBERS = _Kind("numbers", _numeric)
_PLAIN: dict[Any, _Kind] = {
    float: _Kind("a number, in SI units", _number),
    int: _Kind("a whole number", _whole),
    bool: _Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: _Kind("a text", lambda value: isinstance(value, str)),
    type(None): _Kind("", lambda value: value is None),
    NDArray[np.float64]: _NUMBERS,
}


class _Unknown(type):
    """Makes the class that stands for what only type checkers know, with all that is in it."""

    def __getattr__(cls, name: str) -> _Unknown:
        if name.startswith("_"):
            raise AttributeError(name)
        return cls

    def __getitem__(cls, item: object) -> _Unknown:
        return cls


_ANYTHING = _Unknown("Anything", (), {})


class _Names(dict[str, Any]):
    """The names of a module, then Python's own, then those of the library."""

    def __missing__(self, name: str) -> Any:
        if name.startswith("_"):
            raise KeyError(name)
        known = getattr(builtins, name, None)
        return known or getattr(importlib.import_module("energyplan"), name, _ANYTHING)


def _of_class(wanted: type) -> _Kind | None:
    name = wanted.__name__
    if issubclass(wanted, Path):
        return _Kind("the name of a file", lambda value: isinstance(value, os.PathLike))
    if wanted.__module__.partition(".")[0] != "energyplan" or name == "Pose":
        return None
    source = f": {SOURCES[name]}" if name in SOURCES else ""
    article = "an" if name[0] in "AEIOU" else "a"
    return _Kind(f"{article} {name}{source}", lambda value: isinstance(value, wanted))


@cache
def _kind(hint: Any) -> _Kind | None:
    """Return the kind that an annotation means; None where anything may be given."""
    if get_origin(hint) is Annotated:
        return _kind(hint.__origin__)
    if hint in _PLAIN:
        return _PLAIN[hint]
    outer, parts = get_origin(hint), get_args(hint)
    if outer in (Union, UnionType):
        return _either(parts)
    if outer is Literal:
        words = " or ".join(map(repr, parts))
        return _Kind(words, lambda value: isinstance(value, str) and value in parts)
    if outer in (Sequence, tuple, list, Iterable):
        items = _kind(parts[0]) if len({*parts} - {...}) == 1 else None  # of one kind
        return _Kind(f"a list: {items.words}, ..." if items else "a list", _several, items)
    if outer in (Mapping, dict):
        return _Kind("a mapping", lambda value: isinstance(value, Mapping))
    if outer is Callable:
        return _Kind("a function", callable)
    return _of_class(hint) if isinstance(hint, type) and hint is not _ANYTHING else None


def _either(parts: tuple[Any, ...]) -> _Kind | None:
    """Return the kind of one of several annotations; `ArrayLike` is several by itself."""
    arrays = {*get_args(ArrayLike)} if {*get_args(ArrayLike)} <= {*parts} else set()
    found = [_NUMBERS if arrays else None, *(_kind(part) for part in parts if part not in arrays)]
    kinds = [kind for kind in found if kind is not None]
    if len(kinds) < len(found) - (not arrays):
        return None
    alone = [kind.words for kind in kinds if kind.words and kind.items is None]
    lists = [k.items.words for k in kinds if k.items is not None]
    several = ["a list of them" if w in alone else f"a list: {w}, ..." for w in lists]
    return _Kind(" or ".join((*alone, *several)), others=tuple(kinds))


@cache
def _hints(owner: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of the parameters of a function, or of the fields of a dataclass."""
    found: dict[str, Any] = {}
    for part in reversed(owner.__mro__[:-1]) if isinstance(owner, type) else [owner]:
        names = _Names(vars(importlib.import_module(part.__module__)))
        for name, text in inspect.get_annotations(part).items():
            found[name] = eval(text, {}, names) if isinstance(text, str) else text
    return found


@cache
def _kinds(owner: Callable[..., Any]) -> dict[str, _Kind]:
    """Return the kinds of the parameters of a function, or of the fields of a dataclass."""
    # of a choice among names alone the function says which it knows
    found = {
        name: None if get_origin(hint) is Literal else _kind(hint)
        for name, hint in _hints(owner).items()
    }
    if isinstance(owner, type):
        built = {field.name for field in fields(owner) if field.init}
        found = {name: kind for name, kind in found.items() if name in built}
    return {name: kind for name, kind in found.items() if kind is not None and name != "return"}


def _check(kind: _Kind, value: object, name: str, error: type[Exception], whose: str = "") -> None:
    if fault := kind.fault(value, name):
        raise error(f"{whose}{fault}")


def instance(
    value: object, wanted: type, name: str, error: type[Exception] = InvalidInputError
) -> None:
    """Check that a value is of a class: quick, for what is called by the million."""
    if not isinstance(value, wanted):
        raise error(f"{name} is {described(value)}; give {wanted_words(wanted)}")


def wanted_words(wanted: type) -> str:
    """Return what to give where an instance of a class is wanted."""
    kind = _of_class(wanted)
    return kind.words if kind else SOURCES.get(wanted.__name__, f"a {wanted.__name__}")


def check_fields(record: Any, error: type[Exception], whose: str = "") -> None:
    """Check kinds and sizes of a dataclass's fields against their annotations, where it is built.

    A number of NumPy becomes Python's, so that it is shown and saved as one.
    """
    for name, kind in _kinds(type(record)).items():  # type: ignore[arg-type]
        value = getattr(record, name)
        if type(value) is float and kind is _PLAIN[float]:
            continue
        _check(kind, value, name, error, whose)
        if isinstance(value, np.generic | np.ndarray) and _number(value):
            object.__setattr__(record, name, value.item())
    check_sizes(type(record), vars(record), error, whose)


def checked(error: type[Exception] = InvalidInputError) -> Callable[[Function], Function]:
    """Decorate a function so that its arguments are checked against its annotations.

    It warns of arguments that are possible but not usual.
    """

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)

        @wraps(function)
        def held(*args: Any, **options: Any) -> Any:
            try:
                given = signature.bind(*args, **options).arguments
            except TypeError:
                given = {}  # the call below says in Python's own words what is wrong
            for name, kind in _kinds(function).items():
                if name not in given:
                    continue
                several = signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
                for key, value in given[name].items() if several else ((name, given[name]),):
                    _check(kind, value, key, error)
            check_sizes(function, given, error)
            for place, text in doubts(function, given):
                warn(f"{place[0]}: {text}")
            return function(*args, **options)

        return held  # type: ignore[return-value]

    return decorate
