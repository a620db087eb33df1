"""Stands in for ROS' package of this name, which no wheel brings: transforms of one step."""

from __future__ import annotations

from typing import Any


class TransformException(Exception):  # noqa: N818  as ROS names it
    """No transform is known."""


class Buffer:
    """Keeps the last transform between each two frames."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, str], Any] = {}

    def set_transform(self, message: Any, authority: str) -> None:
        """Keep a transform."""
        self.known[message.header.frame_id, message.child_frame_id] = message

    set_transform_static = set_transform

    def lookup_transform(self, target: str, source: str, time: Any) -> Any:
        """Return the last transform from a frame to another."""
        if (target, source) not in self.known:
            raise TransformException(f"{source!r} and {target!r} are not connected")
        return self.known[target, source]


class TransformListener:
    """Listens to nothing: tests set the transforms themselves."""

    def __init__(self, buffer: Buffer, node: Any) -> None:
        self.buffer = buffer
