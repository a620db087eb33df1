"""Tables written as JSON lines: one object a row, its parts named by their way to them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    import pandas as pd

_DEEPEST = 8  # levels of objects in each other that are read
_MOST_PARTS = 4096  # names in a file


def read_json_lines(
    lines: Iterable[bytes], file: object, most: int, error: type[InvalidInputError]
) -> pd.DataFrame:
    """Read rows that are a JSON object each."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    names: dict[str, None] = {}
    for number, line in enumerate(lines, 1):
        row: dict[str, Any] = {}
        if line.strip():
            try:
                made = json.loads(line)
            except (ValueError, RecursionError) as problem:
                raise error(f"{file}, line {number} is no JSON object: {problem}") from None
            if not isinstance(made, dict):
                raise error(f"{file}, line {number} is no JSON object, which a row of a log is")
            row = dict(_parts("", made, 0))
        rows.append(row)
        names |= dict.fromkeys(row)
        if len(names) > _MOST_PARTS or len(rows) * max(len(names), 1) > most:
            raise error(f"{file} has {len(rows)} rows and {len(names)} names or more; split it")
    if not names:
        raise error(f'{file} is empty; each line must be a JSON object such as {{"t": 0.1}}')
    return pd.DataFrame({name: pd.Series([row.get(name) for row in rows]) for name in names})


def _parts(name: str, value: object, depth: int) -> Iterator[tuple[str, object]]:
    """Yield what an object holds by its name, the parts of its parts with a dot between."""
    if isinstance(value, dict) and depth < _DEEPEST:
        for key, part in value.items():
            yield from _parts(f"{name}.{key}" if name else str(key), part, depth + 1)
    elif isinstance(value, list) and depth < _DEEPEST and len(value) <= 64:
        for k, part in enumerate(value):
            yield from _parts(f"{name}[{k}]", part, depth + 1)
    elif value is None or isinstance(value, str | int | float):
        yield name, value
