"""The tread ICRs: about which points of the ground the two sides turn."""

from __future__ import annotations

from dataclasses import dataclass

from energyplan.errors import VehicleError
from energyplan.kinds import check_fields

LARGEST_EXTENT = 1e4
"""Largest size of a vehicle [m]: far beyond any, and far from overflow."""


@dataclass(frozen=True)
class TreadICR:
    """Instantaneous centres of rotation of the two treads, in the body frame.

    Parameters
    ----------
    left, right : float
        Lateral distance of the left and of the right tread's ICR from the body's x axis [m],
        both positive: the left one lies at ``y = +left``, the right one at ``y = -right``.
    longitudinal : float
        Their common x coordinate [m].

    Raises
    ------
    VehicleError
        If a value is not finite or the slip track is not positive.

    References
    ----------
    Morales et al. (2010), section II.

    Examples
    --------
    >>> TreadICR(left=0.5, right=0.25).slip_track
    0.75
    """

    left: float
    right: float
    longitudinal: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, VehicleError, "tread ICR ")
        for name in ("left", "right", "longitudinal"):
            value = getattr(self, name)
            if not abs(value) <= LARGEST_EXTENT:  # not of NaN
                raise VehicleError(f"tread ICR {name} is {value}; give metres")
        if not self.slip_track > 0:
            raise VehicleError(
                f"the slip track left + right is {self.slip_track} m; it must be positive"
            )

    @classmethod
    def symmetric(cls, offset: float) -> TreadICR:
        """Return tread ICRs at equal lateral `offset` [m] on both sides."""
        return cls(offset, offset)

    @property
    def slip_track(self) -> float:
        """Distance between the two tread ICRs, ``B = left + right`` [m]."""
        return self.left + self.right

    @property
    def half_track(self) -> float:
        """Half the slip track [m]: the turn radius of a pivot about one tread's ICR."""
        return 0.5 * self.slip_track

    @property
    def centre(self) -> tuple[float, float]:
        """Body coordinates of the point midway between the tread ICRs [m].

        Seen from this point every vehicle has symmetric tread ICRs.
        """
        return self.longitudinal, 0.5 * (self.left - self.right)


def predict_icr(wheelbase: float, track: float) -> float:
    """Lateral tread ICR offset of a four-wheeled vehicle that was not measured.

    Moment balance of a steady spin with equal point loads and isotropic Coulomb friction:
    ``C = a_x + a_y^2 / a_x`` with half track ``a_x`` and half wheelbase ``a_y``.

    Source: docs/theory, section 1.
    """
    return track / 2 + (wheelbase / 2) ** 2 / (track / 2)
