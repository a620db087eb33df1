"""Tables of what Python functions refuse: a line holds the error, the call and what is said."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest

import energyplan as ep
from energyplan import errors


def lines(table: str) -> list[str]:
    """Return the cases of a table, without its empty lines and its comments."""
    return [line for line in table.splitlines() if line and line[0] != "#"]


def check_refusal(case: str, names: Mapping[str, Any]) -> None:
    """Check a case such as ``MapError: HALL.with_mask(3) | mask is 3``; the words are a pattern."""
    kind, _, rest = case.partition(": ")
    call, _, words = rest.partition(" | ")
    with pytest.raises(getattr(errors, kind)) as caught:
        eval(call, {**{name: getattr(ep, name) for name in ep.__all__}, **names})
    assert re.search(words, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)
