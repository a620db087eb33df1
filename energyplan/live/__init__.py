"""A drive as it happens: a growing log or a stream of lines, learned from sample by sample."""

from energyplan.live.samples import (
    Changed,
    Done,
    Ended,
    Event,
    Learned,
    Line,
    Reassessed,
    Restart,
    Trouble,
    follow,
    lines_of,
)
from energyplan.live.watcher import watch

__all__ = [
    "Changed", "Done", "Ended", "Event", "Learned", "Line", "Reassessed", "Restart", "Trouble",
    "follow", "lines_of", "watch",
]  # fmt: skip
