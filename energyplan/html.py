"""Numbers, names and tables as readers want them: in reports, in notebooks, and printed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

_ROUNDING = 1e-9  # part of a whole below which a part of it is rounding


def number(value: float, digits: int = 4, *, whole: float = 0.0) -> str:
    """Return a number as a reader wants it: `digits` significant ones, no exponent if possible."""
    value = 0.0 if abs(value) <= _ROUNDING * abs(whole) else value
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e" in text and abs(value) >= 1 and abs(value) < 1e9 else text


def column(values: Sequence[float], digits: int = 2) -> list[str]:
    """Return numbers that are compared, with the decimals that the largest one needs."""
    most = max(map(abs, values), default=0.0)
    places = max(0, digits - 1 - math.floor(math.log10(most))) if most > 0 else 0
    return [f"{round(value, places) + 0.0:.{places}f}" for value in values]


def share(part: float) -> str:
    """Return a part of a limit in percent, rounded down so that what is printed keeps the limit."""
    percent = 100 * part * (1 + _ROUNDING)
    places = max(0, 2 - math.floor(math.log10(percent))) if percent > 0 else 0
    return f"{math.floor(percent * 10**places) / 10**places:g} %"


def clock(seconds: float) -> str:
    """Return a time as hours, minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def words(name: str) -> str:
    """Return a name of the code, such as that of an effect, in words."""
    return name.replace("_", " ")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit(symbol: str) -> str:
    """Return a unit as it is printed: powers raised, nothing for the unit of a pure number."""
    return re.sub(r"\^(-?\d+)", lambda m: m[1].translate(_RAISED), symbol) if symbol != "1" else ""


def quantity(value: float, error: float | None, symbol: str) -> str:
    """Return a value with its standard error and unit; the error decides on the digits."""
    text = number(value)
    if error is not None and math.isfinite(error) and error > 0:
        places = max(0, 1 - math.floor(math.log10(error)))
        shown = (f"{value:.{places}f}", f"{error:.{places}f}")
        text = " ± ".join(shown if places <= 8 else (number(value), number(error, 2)))
    return f"{text} {unit(symbol)}".rstrip()


def spanned(value: float, low: float, high: float) -> str:
    """Return a value with its interval, whose width decides on the digits."""
    wide = high - low
    places = max(0, 2 - math.floor(math.log10(wide))) if 0.0 < wide < math.inf else 9
    shown = (f"{one:.{places}f}" if places < 9 else number(one, 3) for one in (value, low, high))
    return "{} ({} to {})".format(*shown)


def chance(probability: float) -> str:
    """Return a probability with as many digits as it bears."""
    if probability < 0.01:
        return "below 0.01"
    return f"{probability:.2f}" if probability <= 0.99 else "above 0.99"


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence gives them; of many the first two, and how many there are more."""
    names = list(dict.fromkeys(names))
    if len(names) <= 3:
        return ", ".join(names)
    return f"{', '.join(names[:2])} and {len(names) - 2} more"


def set_aside(counts: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return how many samples were set aside, by drive and reason, as a line for each reason."""
    drives: dict[str, dict[str, int]] = {}
    for drive, reasons in counts.items():
        for reason, count in reasons.items():
            drives.setdefault(reason, {})[drive] = count
    return [
        f"set aside in {listed(list(of))}: {sum(of.values())} samples: {reason}"
        for reason, of in drives.items()
    ]


WIDE = 4  # a table of more columns than these is shown row by row where a page is narrow

_NUMERIC = re.compile(r"[-+]?\d[-+\d.e±%() to]*|-")


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("energyplan"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True,
    )  # fmt: skip


def rendered(template: str, **values: Any) -> str:
    """Return HTML from one of the package's templates, which escape all text."""
    return str(_templates().get_template(template).render(**values))


class Cells(NamedTuple):
    """The texts of a table; columns of numbers stand to the right, ``-`` stands for nothing."""

    header: tuple[str, ...]
    rows: list[list[str]]
    numeric: list[bool]  # of each column

    @classmethod
    def of(cls, header: Sequence[str], rows: Iterable[Sequence[object]]) -> Cells:
        """Return the texts of values."""
        body = [[_text(value) for value in row] for row in rows]
        numeric = [  # some numbers may be absent
            any(text != "-" for text in column) and all(map(_NUMERIC.fullmatch, column))
            for column in zip(*body, strict=True)
        ]
        return cls((*header,), body, numeric or [False] * len(header))

    @property
    def wide(self) -> bool:
        """Whether it is shown row by row where a page is narrow."""
        return len(self.header) > WIDE


class Summary(NamedTuple):
    """What there is to be said of a result: a title, a table, and notes."""

    title: str
    header: Sequence[str]
    rows: Iterable[Sequence[object]]
    notes: Sequence[str] = ()

    def html(self) -> str:
        """Return it as a notebook shows it."""
        cells = Cells.of(self.header, self.rows)
        return rendered("summary.html", title=self.title, cells=cells, notes=self.notes)

    def text(self) -> str:
        """Return it as lines of text; columns of numbers are aligned to the right."""
        cells = Cells.of(self.header, self.rows)
        body = cells.rows
        lines = [[*self.header], *body] if any(self.header) and body else body
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        aligned = [
            "  ".join(
                text.rjust(width) if right else text.ljust(width)
                for text, width, right in zip(line, widths, cells.numeric, strict=True)
            )
            for line in lines
        ]
        indented = (f"  {line}".rstrip() for line in aligned)
        return "\n".join([self.title, *indented, *(f"- {note}" for note in self.notes)])


class Readable:
    """What shows itself: as tables in a notebook, as lines of text where it is printed."""

    def _summaries(self) -> Iterable[Summary]:
        raise NotImplementedError

    @property
    def tables(self) -> tuple[Summary, ...]:
        """What there is to be said of it, as titled rows."""
        return tuple(self._summaries())

    def _repr_html_(self) -> str:
        return "".join(one.html() for one in self._summaries())

    def __str__(self) -> str:
        return "\n".join(one.text() for one in self._summaries())


def _text(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return number(float(value))
