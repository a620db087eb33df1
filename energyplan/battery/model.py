"""What a mission reads of a battery, and what it gets back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from numpy.typing import ArrayLike

from energyplan.path import FloatArray

BrownOut = Literal["none", "voltage", "charge", "current"]


@dataclass(frozen=True)
class BatteryRun:
    """What a power profile does to a battery.

    After a brown-out the battery is off: it delivers and takes back nothing.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time [s].
    soc, voltage, current : ndarray, shape (n,)
        State of charge, terminal voltage [V] and current [A], positive when discharging, at the
        beginning of each sample.
    lost, braked : ndarray, shape (n,)
        Energy that the battery's resistances turned into heat since the start, and returned
        energy that it could not take and the brake resistors had to [J].
    brown_out : float
        Instant at which the battery gave up [s]; infinite if it did not.
    reason : {"none", "voltage", "charge", "current"}
        Why: voltage below cut-off under the load, empty, or more current than it may deliver.
    polarisation : float
        Voltage of the RC pair at the end [V]; what a next run starts with.

    Examples
    --------
    >>> from energyplan.battery import Battery
    >>> run = Battery.preset("quadriga").simulate([0.0, 60.0, 120.0], [300.0, 300.0, 0.0])
    >>> round(float(run.soc[-1]), 3), run.reason
    (0.991, 'none')
    """

    t: FloatArray
    soc: FloatArray
    voltage: FloatArray
    current: FloatArray
    lost: FloatArray
    braked: FloatArray
    brown_out: float
    reason: BrownOut
    polarisation: float = 0.0

    @property
    def soc_end(self) -> float:
        """State of charge at the end."""
        return float(self.soc[-1])


class BatteryModel(Protocol):
    """What a mission reads of a battery: `Battery` is one, and any class with these is another.

    Examples
    --------
    >>> from energyplan.battery import Battery
    >>> battery: BatteryModel = Battery.preset("quadriga")
    >>> 0 <= battery.cutoff_soc < 1
    True
    """

    @property
    def cutoff_soc(self) -> float:
        """State of charge at which it is switched off, in [0, 1)."""

    @property
    def charge_efficiency(self) -> float:
        """Charge stored over charge supplied, in (0, 1]."""

    @property
    def full_energy(self) -> float:
        """Energy that it holds when full [J]."""

    def simulate(
        self, t: ArrayLike, power: ArrayLike, *, soc: float = 1.0, polarisation: float = 0.0
    ) -> BatteryRun:
        """Run a power profile [W] over times [s], both of shape (n,); see `Battery.simulate`."""

    def usable_energy(self, power: ArrayLike, soc: ArrayLike = 1.0) -> FloatArray:
        """Energy [J] that it delivers at constant power [W], shape (...), until it gives up."""

    def larger(self, energy: float) -> BatteryModel:
        """Return a battery of the same make that holds so much more energy [J] when full."""
