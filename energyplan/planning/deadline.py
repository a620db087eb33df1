"""Time that planning may take, asked by whatever builds or searches for long."""

from __future__ import annotations

import time

from energyplan.errors import TimeLimitError


def in_time(deadline: float, done: str) -> None:
    """Go on, or stop.

    Parameters
    ----------
    deadline : float
        Reading of `time.perf_counter` at which to stop; infinite for never.
    done : str
        How far one has got.

    Raises
    ------
    TimeLimitError
        If the deadline has passed.
    """
    if time.perf_counter() > deadline:
        raise TimeLimitError(f"time was over when {done}; give more time_limit")
