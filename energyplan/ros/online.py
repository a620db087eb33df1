"""Identification while driving: samples from messages as they come in."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from energyplan.errors import MessageError
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.bags import TopicMap

STALE = 1.0
"""Age at which the last value of a channel is no longer taken for the present one [s]."""

_POWERS: tuple[tuple[str, ...], ...] = (("power",), ("p_left", "p_right"), ("voltage", "current"))


class DriveFeed:
    """Feeds an `OnlineIdentifier` from the messages of several topics.

    A sample is made at every message that brings the power. Channels that came more often since
    the sample before are averaged; the last value of one that came less often is kept for a
    second. Nothing is fed while a channel is missing.
    """

    def __init__(self, identifier: OnlineIdentifier, topics: TopicMap) -> None:
        channels = topics.channels
        found = [names for names in _POWERS if set(names) <= set(channels)]
        missing = [name for name in ("v_left", "v_right") if name not in channels]
        if missing or not found:
            raise MessageError(
                f"the topic map {topics.name!r} names no {' and '.join(missing or ['power'])}; "
                "name v_left, v_right, and power, p_left and p_right, or voltage and current"
            )
        self._power = found[0]
        self.identifier = identifier
        self.samples = 0
        """Samples fed so far."""
        self._topics = topics
        self._sums: dict[str, tuple[float, int]] = {}
        self._last: dict[str, tuple[float, float]] = {}
        self._t = float("-inf")

    @property
    def topics(self) -> Sequence[str]:
        """Names of the topics to listen to."""
        sources = (one for many in self._topics.channels.values() for one in many)
        return tuple(dict.fromkeys(source.topic for source in sources))

    def take(self, topic: str, message: Any, t: float) -> bool:
        """Take a message."""
        fresh = set()
        for name, sources in self._topics.channels.items():
            for source in sources:
                if not source.matches(topic):
                    continue
                value = source.value(message)
                if isfinite(value):
                    total, count = self._sums.get(name, (0.0, 0))
                    self._sums[name] = total + value, count + 1
                    self._last[name] = value, t
                    fresh.add(name)
                    break
        if self._power[-1] not in fresh or not t > self._t:
            return False
        return self._feed(t)

    def _feed(self, t: float) -> bool:
        """Feed what has come since the last sample, if it is all there."""
        known = {}
        for name, (value, at) in self._last.items():
            total, count = self._sums.get(name, (0.0, 0))
            if count:
                known[name] = total / count
            elif t - at <= STALE:
                known[name] = value
        self._sums.clear()
        if not {"v_left", "v_right", *self._power} <= set(known):
            return False
        parts = [known.pop(name) for name in self._power]
        power = parts[0] * parts[1] if self._power[0] == "voltage" else sum(parts)
        needed = {name for term in self.identifier.model.terms for name in term.channels}
        more = {name: value for name, value in known.items() if name in needed}
        left, right = known["v_left"], known["v_right"]
        changed = self.identifier.update(t, left, right, power, **more)
        self._t = t
        self.samples += 1
        return changed
