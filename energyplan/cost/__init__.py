"""What a motion costs: joules as a function of curvature and speed, for any power model.

Along a path driven at the cheapest admissible speed the energy of an element depends on the arc
length ``ds`` and the turn ``dtheta`` alone, and is homogeneous in them (docs/theory, section 3).
`EnergyCost` holds that function for the model it is given, whatever its terms.

**Slopes.** On level ground no element costs less than nothing, which shortest-path searches rely
on. A slope's weight gives back downhill what it took uphill: without losses its work is the
difference of a potential, ``m g`` times the height, whatever the route. So a search runs on the
level cost, which stays positive, and adds the potential's difference between start and goal once,
at the end. Where returned energy is partly lost, a part of it is taken as the potential, and what
an element costs beyond it is again never negative (docs/planner, "Slopes").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost import direction_table, speeds, steering
from energyplan.cost.bounds import SLACK, Infimum, LowerBound, least_between, lower_bound
from energyplan.cost.direction_table import Corners, DirectionTable
from energyplan.cost.driving import SteadyDriving
from energyplan.errors import InvalidInputError, ModelError
from energyplan.path import ROUNDING, FloatArray, Path
from energyplan.power import SLIP, TRACTION, PowerModel
from energyplan.records import checked
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle, layout, wheel_loads

_ALL_ROUND = -np.pi, np.pi  # headings [rad]
_STANDSTILL, _SCAN = 1e-7, 97  # slowest speed tried, over the largest, and how many are tried


class DrivenRates(NamedTuple):
    """Rates of a bound on drives; see `energyplan.planning.driven.driven_bound`."""

    share: float  # least price of a motion at any speed, over its price at steady speeds [1]
    still: float  # least price of a second at any speed
    # how quickly the steady price of what is covered in a second grows at most, from a standstill
    quickest: float


@dataclass(frozen=True, eq=False)
class EnergyCost(SteadyDriving):
    """Energy of path elements, from any power model.

    Parameters
    ----------
    model : PowerModel
        The power model with its vehicle. No term may read a channel that a cost cannot know, such
        as the place, unless `channels` gives it a constant value. A term may read the heading
        ``yaw``, as across the rows of a field; the speeds of such a cost are those that suit the
        mean over all headings.
        What it contains of the ground of some place, such as a slope that a diagnosis found, is
        left out, for a cost knows no map: problems and missions put it on theirs.
    battery : bool
        Whether energy is measured at the battery, with the vehicle's drive and regeneration
        efficiencies, rather than at the treads.
    speed : float or "cheapest", optional
        Tread speed to drive at [m/s], that of the faster tread; slower where a limit requires it.
        With ``"cheapest"`` every element is driven at its cheapest admissible speed, and at
        the fastest of them where several cost the same. Where it is not given, the robot drives
        at its vehicle's typical speed, or as fast as its motors go; where neither is known, or time
        has a value, at the cheapest. `tread_speed` says which.
    channels : mapping of str to float
        Constant values of further channels that the model's terms read, such as a temperature.
    time_value : float
        Value of a second where the speed is chosen [J/s]. It is not part of the energy: the
        robot hurries, and pays for it.
    speed_limit : float
        Largest speed of the reference point [m/s]. Turning on the spot is as fast as without it.

    Raises
    ------
    InvalidInputError
        If `speed` or `speed_limit` is not positive, or `time_value` is negative or not finite.
    MissingChannelError
        If a term reads a channel that a cost cannot know.
    ModelError
        If some motion costs no energy or returns it, or if the cost has no minimum because the
        vehicle has no speed limit.

    References
    ----------
    docs/theory, sections 3 and 5.

    Examples
    --------
    >>> from energyplan.power import PowerModel
    >>> cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    >>> float(cost.segment_energy(1.0, 0.0).round(1))  # two sides of 113 N over a metre
    226.0
    """

    @np.errstate(all="ignore")  # what overflows is refused
    def __post_init__(self) -> None:
        super().__post_init__()
        if not (lowest := float(self.gauge.values.min())) > 0:
            x, y = self.gauge.directions[int(np.argmin(self.gauge.values))]
            raise ModelError(
                f"the model {self.model.name!r} gives {lowest:.3g} J to an element of {x:.3g} m "
                f"and {y / self.half_track:.3g} rad on level ground; motion must cost energy: "
                "check the signs of its coefficients"
            )

    @classmethod
    @checked()
    def from_coefficients(
        cls, per_metre: float, per_radian: float, icr: float | TreadICR, speed: float = 1.0
    ) -> EnergyCost:
        """Return the cost of the static model with these coefficients.

        Parameters
        ----------
        per_metre : float
            Energy of straight driving, ``a = 2 K`` [J/m].
        per_radian : float
            Energy of turning beyond that of the treads' travel, ``beta = mu S`` [J/rad].
        icr : float or TreadICR
            Tread ICRs, or their lateral offset where both are the same [m].
        speed : float
            Largest tread speed [m/s]; it sets durations only.

        Returns
        -------
        EnergyCost
            ``per_metre max(|ds|, C |dtheta|) + per_radian |dtheta|``.

        Raises
        ------
        InvalidInputError
            If `per_metre` is not positive or `per_radian` is negative.

        Examples
        --------
        >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
        >>> [round(float(e), 6) for e in cost.segment_energy([1.0, 0.0, 0.5], [0.0, 1.0, 1.0])]
        [200.0, 200.0, 200.0]
        """
        return cls(_static_model(per_metre, per_radian, icr, speed))

    # -- energy ---------------------------------------------------------------------------------

    def _element_energy(
        self, x: FloatArray, y: FloatArray, slope: ArrayLike = 0.0, yaw: ArrayLike | None = None,
        rate: FloatArray | None = None,
    ) -> FloatArray:  # fmt: skip
        """Energy of elements [J], evaluated through the model; they must not vanish.

        Where it depends on the heading and none is given, that of the heading with the least.
        """
        if yaw is None and self.of_heading:
            x, y, slope = np.broadcast_arrays(x, y, slope)
            return least_between(
                lambda at: self._element_energy(x, y, slope, at, rate), *_ALL_ROUND, x.shape
            )
        if rate is None:
            return self._as_driven(self._element_energy, x, y, slope, 0.0 if yaw is None else yaw)
        safe = np.where(np.isfinite(rate), rate, 1.0 / (np.abs(x) + np.abs(y)))
        motion = self._motion(x, y, safe, slope, 0.0 if yaw is None else yaw)
        return np.asarray(self._drawn.power(motion) / safe)

    @cached_property
    def gauge(self) -> DirectionTable:
        """Energy over the direction of motion, tabulated, with the error of the table."""
        return direction_table.tabulate(self._element_energy)

    def segment_energy(
        self,
        ds: ArrayLike,
        dtheta: ArrayLike,
        slope: ArrayLike | None = None,
        *,
        exact: bool = True,
        yaw: ArrayLike | None = None,
    ) -> FloatArray:
        """Return the energy of arcs, as they are driven.

        Parameters
        ----------
        ds : array_like, shape (...)
            Signed arc length of the reference point [m], as in `Path`.
        dtheta : array_like, shape (...)
            Signed turn [rad].
        slope : array_like, shape (...), optional
            Slope of the ground along the heading [rad], positive when climbing along +x; level
            where not given. A slope is evaluated through the model, which is slower than the
            table that serves level ground, and at the speeds of level ground.
        exact : bool
            Whether the speeds on slopes are searched again; else they come from a table, which is
            quicker where energy depends on speed.
        yaw : array_like, shape (...), optional
            Heading all along [rad], for a model that reads it. Where it is not given, the energy is
            that at the heading of each arc that takes the least: a lower bound.

        Returns
        -------
        ndarray, shape (...)
            Energy [J]. On level ground it is never negative, and accurate to `gauge.error`,
            which is of the order of rounding for piecewise linear energies.
        """
        x, y = self._element(ds, dtheta)
        if not self.of_heading:
            yaw = None
        if slope is None and yaw is None:
            return self.gauge(x, y)
        x, y = np.broadcast_arrays(x, y)
        moves = (x != 0) | (y != 0)
        x = np.where(moves, x, 1.0)
        rate = None if exact or self._static or self.tread_speed else 1.0 / self._clock(x, y)
        tilt = 0.0 if slope is None else slope
        return np.where(moves, self._element_energy(x, y, tilt, yaw, rate), 0.0)

    @checked()
    def energy(self, path: Path, slope: ArrayLike = 0.0, yaw: ArrayLike | None = None) -> float:
        """Return the energy of a path [J], evaluated through the model.

        The slope along the heading of each segment may be given [rad]. Where the model reads the
        heading it is the path's own, unless that of each segment is given [rad].

        Raises
        ------
        InvalidInputError
            If the path belongs to a vehicle with tread ICRs elsewhere along its x axis.
        """
        return float(self._element_energy(*self._moving(path, slope, yaw)).sum())

    @checked()
    def breakdown(
        self, path: Path, slope: ArrayLike = 0.0, yaw: ArrayLike | None = None
    ) -> dict[str, float]:
        """Return the energy of a path by term [J]; the values add up to `energy`."""
        x, y, tilt, ahead = self._moving(path, slope, yaw)
        rate = self._rate(x, y)
        rate = np.where(np.isfinite(rate), rate, 1.0 / (np.abs(x) + np.abs(y)))
        parts = self._drawn.breakdown(self._motion(x, y, rate, tilt, ahead))
        return {name: float((power / rate).sum()) for name, power in parts.items()}

    @checked()
    def per_metre(self, curvature: ArrayLike, speed: ArrayLike | None = None) -> FloatArray:
        """Return the energy per metre [J/m] on arcs of a curvature [1/m], positive to the left.

        The speed of the reference point may be given [m/s], and exceed `admissible_speed`.
        """
        return self._per_unit(np.ones(np.shape(curvature)), curvature, speed)

    @checked()
    def per_radian(self, radius: ArrayLike = 0.0, rate: ArrayLike | None = None) -> FloatArray:
        """Return the energy per radian [J/rad] of a turn to the left.

        The radius is the signed distance of the reference point per radian [m]: 0 for a spin,
        ``+-C`` for pivots. The yaw rate may be given [rad/s].
        """
        return self._per_unit(radius, np.ones(np.shape(radius)), rate)

    def _per_unit(self, ds: ArrayLike, dtheta: ArrayLike, rate: ArrayLike | None) -> FloatArray:
        if rate is None:
            return self.segment_energy(ds, dtheta)
        speed = np.asarray(rate, float)
        if not np.all(speed > 0):
            raise InvalidInputError("a speed is not positive; give magnitudes, and signs in arcs")
        x, y = self._element(ds, dtheta)
        self.check_any_heading("the energy at a given speed")
        return np.asarray(self._drawn.power(self._motion(x, y, speed)) / speed)

    # -- what searches need -----------------------------------------------------------------------

    @checked()
    def lower_bound(self, point: tuple[float, float] = (0.0, 0.0)) -> LowerBound:
        """Return coefficients ``(a, beta)`` of ``E >= a length + beta |turn|`` for any motion.

        The length is that of the path of a body point [m], and ``a`` the largest there is: that
        of the cheapest straight line unless a turn moves the point for less (docs/theory, section
        5).
        """
        return lower_bound(self._element_energy, self.icr, point)

    def driven_rates(self, energy: float = 1.0, time: float = 0.0) -> DrivenRates | None:
        """Return what no drive takes less than, where a joule and a second are weighed.

        Drives pass all speeds from a standstill up to the largest; a motion may take less at one of
        them than at the speed that it is priced at. None where nothing limits the tread speed.
        """
        top = min(self.vehicle.motor.speed, self.tread_speed or np.inf)
        if not np.isfinite(top):
            return None
        steady = self.same_at_any_speed and self._least_drawn is self._drawn
        if self.of_heading and steady and not time:
            return DrivenRates(1.0, 0.0, np.inf)

        def price(x: FloatArray, y: FloatArray, yaw: FloatArray | None = None) -> FloatArray:
            joules = self._element_energy(x, y, yaw=yaw) if energy else 0.0
            return np.asarray(
                energy * joules + (time * self._element_duration(x, y) if time else 0)
            )

        def power(x: FloatArray, y: FloatArray, yaw: ArrayLike, rate: FloatArray) -> FloatArray:
            if not energy:
                return np.full(np.broadcast_shapes(x.shape, np.shape(rate)), time)
            drawn = self._least_drawn.power(self._motion(x, y, rate, yaw=yaw))
            return np.asarray(energy * drawn + time)

        def least(
            value: Callable[[FloatArray, FloatArray, ArrayLike, FloatArray], FloatArray],
            x: FloatArray, y: FloatArray, yaw: ArrayLike = 0.0,
        ) -> FloatArray:  # fmt: skip
            """Return the least values over all speeds."""
            with np.errstate(divide="ignore"):
                turns = self.vehicle.max_yaw_rate * self.half_track / np.abs(y)
            limit = np.asarray(np.minimum(top / (np.abs(x) + np.abs(y)), turns))
            limit = self._within_limit(x, y, limit)
            of = partial(value, x, y, yaw)
            return of(speeds.cheapest_rate(_STANDSTILL * limit, limit, of, _SCAN))

        def per_element(
            x: FloatArray, y: FloatArray, yaw: ArrayLike, rate: FloatArray
        ) -> FloatArray:
            return np.asarray(power(x, y, yaw, rate) / rate)

        def part(x: FloatArray, y: FloatArray, prices: FloatArray) -> FloatArray:
            """Return the least part of the price, at the heading where it is least."""
            x, y = x.ravel(), y.ravel()
            if not self.of_heading:
                return np.asarray(least(per_element, x, y) / prices.ravel())

            def at(yaw: FloatArray) -> FloatArray:
                ahead, across = (np.broadcast_to(one, yaw.shape) for one in (x, y))
                return np.asarray(least(per_element, ahead, across, yaw) / price(x, y, yaw))

            return least_between(at, *_ALL_ROUND, x.shape)

        infimum = Infimum(price)
        share = infimum.least(part)
        # the speed that is priced is one of them
        share = 1.0 if share >= 1.0 - ROUNDING else share * (1.0 - SLACK)
        if self.of_heading or not np.isfinite(self.vehicle.motor.acceleration):
            return DrivenRates(share, 0.0, np.inf)
        still = infimum.least(lambda x, y, _: least(power, x.ravel(), y.ravel()))
        travel = infimum.least(lambda x, y, prices: (np.abs(x) + np.abs(y)) / prices)
        quickest = self.vehicle.motor.acceleration * (1.0 + SLACK) / (travel * (1.0 - SLACK))
        return DrivenRates(share, max(still - SLACK * abs(still), 0.0), quickest)

    @cached_property
    def _corners(self) -> Corners:
        return self.gauge.corners()

    @property
    def steering_error(self) -> float:
        """Fraction by which `steering` may miss the minimum, since corners were dropped."""
        return 0.0 if self.gauge.is_static else self._corners.error + self.gauge.error

    @cached_property
    def steering_parameters(self) -> steering.Steering:
        """What steering reads."""
        return steering.steering_of(self.gauge, self._corners, self.icr)


def _static_model(
    per_metre: float, per_radian: float, icr: float | TreadICR, speed: float
) -> PowerModel:
    """Return the paper's model with these coefficients; see `EnergyCost.from_coefficients`."""
    if not (np.isfinite(per_metre) and per_metre > 0):
        raise InvalidInputError(f"per_metre is {per_metre}; give joules per metre > 0")
    if not (np.isfinite(per_radian) and per_radian >= 0):
        raise InvalidInputError(f"per_radian is {per_radian}; give joules per radian >= 0")
    treads = icr if isinstance(icr, TreadICR) else TreadICR.symmetric(icr)
    width = treads.slip_track
    # its wheels are unknown: they are placed near the centre, inside any footprint it may be given
    contacts, box = layout(0.1 * width, 0.1 * width, 2 * width, 2 * width)
    loads, motor = wheel_loads(contacts, 1.0), MotorLimits(speed=speed)
    vehicle = Vehicle("coefficients", contacts, loads, treads, box, motor)
    mu = per_radian / vehicle.slip_moment
    return PowerModel(vehicle, (SLIP, TRACTION), np.array([mu, per_metre / 2]), name="coefficients")
