"""What would make a task reachable, in a form that a program can apply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

RemedyKind = Literal[
    "charge", "capacity", "reserve", "speed", "cheapest_speed", "window", "drop"
]  # fmt: skip

_SENTENCES: dict[RemedyKind, str] = {
    "charge": "charge to {percent:.0f} % before leaving",
    "capacity": "a battery with {hours:.0f} Wh more",
    "reserve": "a reserve of {percent:.3g} %",
    "speed": "drive at up to {amount:.3g} m/s",
    "cheapest_speed": "drive at the speed of least energy",
    "window": "let it begin {amount:.0f} s later",
    "drop": "drop {task!r}",
}


@dataclass(frozen=True)
class Remedy:
    """A change of a mission that makes a task reachable; `Mission.with_remedy` applies it.

    Parameters
    ----------
    kind : str
        What to change: ``"charge"`` (state of charge at the start), ``"capacity"`` (so much more
        energy in the battery), ``"reserve"``, ``"speed"``, ``"cheapest_speed"``,
        ``"window"`` (a task's window ends so much later), ``"drop"`` (leave a task out).
    amount : float or None
        How much, in `unit`; None where there is nothing to measure.
    unit : {"", "1", "J", "m/s", "s"}
        Unit of the amount; ``"1"`` is a fraction.
    task : str
        The task that is changed or dropped; empty where the whole mission is.

    Examples
    --------
    >>> remedy = Remedy("charge", 0.88, "1", "")
    >>> f"charge to {remedy.amount:.0%} before leaving"
    'charge to 88% before leaving'
    """

    kind: RemedyKind
    amount: float | None = None
    unit: str = ""
    task: str = ""

    def __str__(self) -> str:
        amount = 0.0 if self.amount is None else self.amount
        return _SENTENCES[self.kind].format(
            amount=amount, percent=100 * amount, hours=amount / 3600, task=self.task
        )
