"""Finds the class of a message by its name."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def get_message(name: str) -> Any:
    """Return the class of a message such as ``nav_msgs/msg/Path``."""
    package, kind, message = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), message)
