"""Open-RMF: what its battery estimate needs, what error that leaves, and its task requests.

Its vocabulary stays here. Nothing of Open-RMF is imported.
"""

from energyplan.openrmf.power import (
    FleetConfig,
    PowerError,
    fleet_config,
    power_error,
    sink_energy,
)
from energyplan.openrmf.tasks import read_requests, tasks_of

__all__ = [
    "FleetConfig", "PowerError", "fleet_config", "power_error", "read_requests", "sink_energy",
    "tasks_of",
]  # fmt: skip
