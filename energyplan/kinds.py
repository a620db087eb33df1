"""Former name of the checker of arguments."""

from energyplan.records import *  # noqa: F403
from energyplan.records import _kinds as _kinds
