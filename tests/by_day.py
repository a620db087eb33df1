"""Cases of a parametrised test: some are tried in every run, and all of them at night."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def by_day(cases: Iterable[Any], day: Collection[Any]) -> list[Any]:
    """Return cases as parameters: those that are not of `day` wait for `make nightly`.

    Raises
    ------
    ValueError
        If `day` names what is no case: nothing would be tried in its place.
    """
    cases = list(cases)
    if unknown := [one for one in day if one not in cases]:
        raise ValueError(f"by day there are no cases {unknown}")
    nightly = pytest.mark.nightly
    return [pytest.param(one, marks=() if one in day else nightly) for one in cases]
