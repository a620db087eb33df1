"""The energy that it takes to reach each place of a map, and how far a given energy is enough."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import NormalDist
from typing import Any, NamedTuple

import contourpy
import numpy as np
import shapely
from numpy.typing import ArrayLike

from energyplan.battery import SAGS, Battery
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.path import ROUNDING, FloatArray, Pose
from energyplan.planning.budget import Budget
from energyplan.planning.goal import Goal
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.search import lattice as kernels
from energyplan.planning.search.lattice import Search, coarse_lattice
from energyplan.planning.several import none_free
from energyplan.planning.space import prices
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.cost_to_go import no_cost_to_go
from energyplan.planning.space.motions import DIRECTIONS, KernelProblem
from energyplan.records import checked, numbers

STEADY = 10.0  # time constants after which the RC pair of a battery is steady
STEP = 0.01  # part of a standard deviation by which coefficients are changed to see what that does


@dataclass(frozen=True, eq=False)
class UpperPrices:
    """Prices that motions exceed with a small probability only."""

    extra: FloatArray  # (classes * slopes, rays): what is added to the mean price of each ray
    noise: float  # [J]
    quantile: float  # standard deviations that are added

    def whole(self, priced: FloatArray) -> FloatArray:
        """Return what whole paths take at most, given the sum of their prices [J]."""
        if self.noise == 0.0:
            return priced
        return np.asarray(priced + self.quantile * np.sqrt(self.noise * priced))


def upper_prices(query: CompiledProblem, confidence: float, spread: float) -> UpperPrices:
    """Return prices that bound the energy of paths with a probability."""
    from energyplan.fit.doubts import unfounded  # slow to import, and rarely needed
    from energyplan.fit.run import RunEffect

    if not 0.5 <= confidence < 1.0:
        raise InvalidInputError(f"the confidence is {confidence}; give a part from 0.5 to below 1")
    if not 0.0 <= spread < 1.0:
        raise InvalidInputError(
            f"the coefficient spread is {spread}; give a part from 0 to below 1"
        )
    quantile = NormalDist().inv_cdf(confidence)
    ds, dtheta, along, slope, yaw, rows = _rays(query)
    extra, noise = [], 0.0
    for cost in query.costs:
        if reason := unfounded(cost.model, confidence, spread):
            raise InvalidInputError(reason)
        mean = cost.segment_energy(along, dtheta, slope, yaw=yaw) + rows
        run = RunEffect.known(cost.model.residual)
        square = (run.error**2 + run.deviation**2) * mean**2
        for step in _directions(cost, spread).T:
            more, less = (
                replace(
                    cost,
                    model=cost.model.with_coefficients(
                        cost.model.coefficients + sign * STEP * step
                    ),
                ).segment_energy(along, dtheta, slope, yaw=yaw)
                for sign in (1.0, -1.0)
            )
            square = square + (0.5 * (more - less) / STEP) ** 2
        extra.append(quantile * np.sqrt(square))
        if run.density > 0:
            level, seconds = cost.segment_energy(ds, dtheta), cost.segment_duration(ds, dtheta)
            noise = max(noise, float(np.max(run.density * seconds / level)))
    return UpperPrices(np.concatenate(extra).reshape(-1, len(ds)), noise, quantile)


class UsableCharge:
    """What a battery delivers between a state of charge and the reserve, as in a mission."""

    def __init__(
        self, cost: EnergyCost, battery: Battery, soc: float = 1.0, reserve: float = 0.0
    ) -> None:
        """Refuse a battery that delivers nothing to the motion of most power, with the reason."""
        cutoff = battery.cutoff_soc
        if soc <= reserve + ROUNDING:
            raise InvalidInputError(
                f"the reserve {reserve:g} is not below the state of charge {soc:g}; charge first, "
                "or lower the reserve"
            )
        if soc <= cutoff + ROUNDING:
            raise InvalidInputError(
                f"the state of charge {soc:g} is not above {cutoff:g}, at which the battery is cut "
                "off; charge first"
            )
        self.battery, self.soc, self.kept = battery, soc, reserve
        powers = steady_powers(cost)
        most = float(np.max(powers))
        if not self._delivered(most) > 0:
            t = np.linspace(0.0, STEADY * battery.pair_time, 100)
            reason = battery.simulate(t, np.full(len(t), most), soc=soc).reason
            why = SAGS.get(reason, SAGS["voltage"])
            raise InvalidInputError(
                f"battery {battery.name}: at a charge of {100 * soc:g} % it cannot feed the motion "
                f"of most power, {most:.0f} W: {why}; give a battery with more strings in "
                "parallel, or more charge"
            )
        self.energy = float(self._delivered(np.min(powers[..., 0])))  # of straight driving [J]

    def _delivered(self, power: ArrayLike) -> FloatArray:
        return self.battery.usable_energy(power, self.soc, self.kept)

    def factor(self, power: FloatArray) -> FloatArray:
        """Return what a joule at a power [W] counts, one at that of straight driving being 1."""
        least = np.spacing(self.energy)
        delivered = self._delivered(np.maximum(power, least))
        return np.maximum(self.energy / np.maximum(delivered, least), 1.0)


def steady_powers(cost: EnergyCost) -> FloatArray:
    """Return the powers of steady motions on level ground [W]; straight ahead is the first."""
    angle = np.linspace(0.0, 2.0 * np.pi, 65)
    ds, dtheta = np.cos(angle), np.sin(angle) / cost.half_track
    yaw = np.linspace(-np.pi, np.pi, 65)[:, None] if cost.of_heading else None
    joules = cost.segment_energy(ds, dtheta, yaw=yaw)
    return np.asarray(joules / cost.segment_duration(ds, dtheta))


class _Rays(NamedTuple):
    """Motions whose prices a search reads: one of each direction, on each slope and heading."""

    ds: FloatArray  # (rays,): length seen from above [m]
    dtheta: FloatArray  # (rays,): turn [rad]
    along: FloatArray  # (slopes, rays): length along the slope [m]
    slope: FloatArray  # (slopes, 1) [rad]
    yaw: FloatArray | None  # (headings, 1) [rad]
    rows: FloatArray  # (headings or slopes, rays): nothing, in the shape of prices


def _rays(query: CompiledProblem) -> _Rays:
    half = query.problem.cost.half_track
    ds, dtheta = query.reference(query.rays[:, 0], query.rays[:, 1] / half)
    steep = np.zeros((1, 1))
    if query.steepest > prices.FLAT:
        steep = np.linspace(-query.steepest, query.steepest, prices.BINS)[:, None]
    along, slope = ds * np.hypot(1.0, steep), np.arctan(steep)
    yaw = None if query.yaws is None else query.yaws[:, None]
    rows = np.zeros((1 if yaw is None else len(yaw), *np.broadcast_shapes(along.shape, ds.shape)))
    return _Rays(ds, dtheta, along, slope, yaw, rows)


def _counted(query: CompiledProblem, charge: UsableCharge, extra: FloatArray | float) -> FloatArray:
    """Return what is added to the prices so that each joule counts as the battery feels it."""
    rays, priced = _rays(query), []
    for cost in query.costs:
        joules = cost.segment_energy(rays.along, rays.dtheta, rays.slope, yaw=rays.yaw) + rays.rows
        power = joules / cost.segment_duration(rays.along, rays.dtheta)
        priced.append((joules, charge.factor(power) - 1.0))
    joules, more = (
        np.concatenate(one).reshape(-1, len(rays.ds)) for one in zip(*priced, strict=True)
    )
    return np.asarray(extra + more * np.maximum(joules + extra, 0.0))


def _directions(cost: EnergyCost, spread: float) -> FloatArray:
    """Return the changes of the coefficients per independent unknown, shape (terms, unknowns)."""
    model = cost.model
    own = [np.diag(spread * model.coefficients)] if spread > 0 else []
    return np.column_stack([*own, model.principal_directions()])


CELLS = 2  # cells of the lattice to a cell of the raster, along either axis
STEPS = 5  # areas that are reported of a map
STRIDE = 20_000  # expansions between two looks at what is reached


class Contour(NamedTuple):
    """The places that an energy leads to."""

    energy: float  # the energy [J]
    area: shapely.MultiPolygon  # the places, in the world [m]


@dataclass(frozen=True, eq=False)
class EnergyMap:
    """The energy that it takes to reach each place of a map.

    Attributes
    ----------
    energy : ndarray, shape (rows, columns)
        Energy to reach the place at any heading, and to get back where `back` is set [J]; infinite
        where none was reached. Row 0 is the lowest. With a battery, as `UsableCharge` counts it.
    resolution : float
        Size of a place [m].
    origin : Pose
        Outer corner of place (0, 0) in the world, as that of an `OccupancyGrid`.
    start : Pose
        Where the robot sets out.
    back : Pose or None
        Where it has to get back to; one of the poses that `goals` allow where there are several.
    complete_to : float
        What takes up to this energy is on the map [J]; infinite where all places are.
    confidence : float or None
        Probability with which each place takes no more than its `energy`; None where that is what
        the model expects.
    goals : tuple of Goal
        The goals of which it has to get back to one; empty where that is a single pose.
    """

    energy: FloatArray
    resolution: float
    origin: Pose
    start: Pose
    back: Pose | None
    complete_to: float
    confidence: float | None = None
    goals: tuple[Goal, ...] = ()

    @checked()
    def reachable(self, energy: float) -> float:
        """Return the area of the places that an energy [J] leads to [m^2]."""
        return float(np.count_nonzero(self.energy <= energy)) * self.resolution**2

    def energy_at(self, points: ArrayLike) -> FloatArray:
        """Return the energy of the places that hold world points (..., 2) [m]; infinite elsewhere.

        Parameters
        ----------
        points : array_like, shape (..., 2)
            Points x, y [m].

        Returns
        -------
        ndarray, shape (...)
            Energies [J].
        """
        at = numbers(points, "points", last=2, words="x, y [m]")
        offset = at - np.array(self.origin[:2])
        c, s = np.cos(self.origin.yaw), np.sin(self.origin.yaw)
        cell = np.floor(offset @ np.array([[c, -s], [s, c]]) / self.resolution).astype(int)
        rows, columns = self.energy.shape
        inside = np.all((cell >= 0) & (cell < np.array([columns, rows])), axis=-1)
        column, row = np.moveaxis(np.where(inside[..., None], cell, 0), -1, 0)
        return np.where(inside, self.energy[row, column], np.inf)

    @checked()
    def contours(self, levels: Sequence[float]) -> tuple[Contour, ...]:
        """Return the areas that some energies lead to, the least energy first.

        Parameters
        ----------
        levels : sequence of float
            Energies [J].

        Returns
        -------
        tuple of Contour
            The areas, which hold one another.
        """
        if not all(np.isfinite(level) and level > 0 for level in levels):
            raise InvalidInputError(f"levels are {list(levels)}; give energies > 0 [J]")
        # what is out of reach is far beyond every level, so that lines run along its edge
        wide = np.pad(self.energy, 1, constant_values=np.inf)
        x = (np.arange(wide.shape[1]) - 0.5) * self.resolution
        y = (np.arange(wide.shape[0]) - 0.5) * self.resolution
        found = []
        for level in sorted(levels):
            beyond = np.where(wide <= level, wide, np.where(np.isfinite(wide), wide, 2.0 * level))
            made = contourpy.contour_generator(x, y, beyond, fill_type="OuterOffset")
            polygons = []
            for points, offsets in zip(*made.filled(-np.inf, level), strict=True):
                rings = [points[a:b] for a, b in pairwise(offsets)]
                polygons.append(shapely.Polygon(rings[0], rings[1:]))
            area = shapely.MultiPolygon(polygons)
            found.append(Contour(float(level), shapely.transform(area, self._to_world)))
        return tuple(found)

    def areas(self, energy: float | UsableCharge | None = None) -> tuple[Contour, ...]:
        """Return `contours` in `STEPS` even steps up to an energy [J], or what a battery holds.

        Where none is given, or nothing lies beyond it, up to that of the farthest place.
        """
        energy = energy.energy if isinstance(energy, UsableCharge) else energy
        farthest = float(self.energy[np.isfinite(self.energy)].max(initial=0.0))
        limit = farthest if energy is None or np.isinf(self.complete_to) else energy
        levels = [limit * (k / STEPS) for k in range(1, STEPS + 1)]
        return self.contours(levels) if limit > 0 else ()

    def _to_world(self, points: FloatArray) -> FloatArray:
        c, s = np.cos(self.origin.yaw), np.sin(self.origin.yaw)
        return np.asarray(points @ np.array([[c, s], [-s, c]]) + np.array(self.origin[:2]))


@checked()
def energy_map(
    problem: PlanningProblem,
    *,
    energy: float | UsableCharge = np.inf,
    back: Any = None,
    confidence: float | None = None,
    coefficient_spread: float = 0.0,
    effort: int = 20_000_000,
) -> EnergyMap:
    """Find the energy that it takes to reach each place of a map.

    This is one search without a goal, on a lattice half as fine as the one that planning begins
    with. The energies are those of drivable paths. They are never below the least, and usually a
    few per cent above it.

    Parameters
    ----------
    problem : PlanningProblem
        The problem; its goal and its costmap are not used.
    energy : float or UsableCharge
        Energy beyond which places are of no interest [J], or what a battery holds. Then motions of
        a higher power than straight driving count as much more as the battery delivers less at
        that power.
    back : array_like, shape (3,) or (2,), Goal, or a list of these, optional
        Pose that the robot has to reach afterwards, such as a charger's; the place ``(x, y)``, at
        any heading; or one of several, the one that costs least from each place (see `Goal`). Then
        the energy of a place is that to the place and on from there, at the heading with the least
        sum.
    confidence : float, optional
        Probability, for each place, that getting there takes no more than the energy given, such
        as 0.95. It follows from the model's covariance, its error on hold-out drives, and from how
        much runs differ as a whole (by 5 % where the model does not know). The energy given is
        never below this quantile, and a little above it, because motions are priced one by one.
    coefficient_spread : float
        Relative standard deviation of each coefficient from day to day, on top of that.
    effort : int
        Largest number of expansions of either search.

    Returns
    -------
    EnergyMap
        The energies.

    Raises
    ------
    StartInCollisionError, GoalInCollisionError, OutsideMapError
        If the start, or all poses to get back to, cannot be; the message names the pose.
    InvalidInputError
        If the objective is another than energy, the energy is not positive, or a confidence is
        requested of a model without a known uncertainty.

    Examples
    --------
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.terrain import OccupancyGrid
    >>> hall = OccupancyGrid(np.zeros((80, 120), bool), resolution=0.1)
    >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.3)
    >>> found = energy_map(PlanningProblem(hall, cost, (6, 4, 0), (6, 4, 0)))
    >>> bool(200 * 3.5 < found.energy_at((10, 4)) < 200 * 4.5)
    True
    """
    charge = energy if isinstance(energy, UsableCharge) else None
    energy = energy.energy if isinstance(energy, UsableCharge) else energy
    if not energy > 0:
        raise InvalidInputError(f"the energy is {energy} J; give a positive number")
    if coefficient_spread != 0 and confidence is None:
        raise InvalidInputError("a coefficient spread needs a confidence; give both")
    if problem.objective != "energy":
        raise InvalidInputError("a map of energies has the objective 'energy'; leave it out")
    surfaces = None if problem.surfaces is None else problem.surfaces.unpriced
    problem = replace(problem, goal=problem.start, goals=(), costmap=None, surfaces=surfaces)
    there = compiled(problem)
    upper, extra = None, np.zeros(())
    if confidence is not None:
        upper = upper_prices(there, confidence, coefficient_spread)
        extra = upper.extra
    if charge is not None:
        extra = _counted(there, charge, extra)

    def priced(setting: KernelProblem) -> KernelProblem:
        return setting._replace(prices=setting.prices + extra)

    lattice = coarse_lattice(there.setting)
    spacing = CELLS * lattice.cell
    # the search's energies exclude the potential energy of the height
    rise = _rise(there, spacing)
    lowest = float(rise.min(initial=0.0))
    out = _search(priced(there.setting), lattice, energy - lowest, effort)
    table = _table(out, lattice, spacing, there.setting)
    complete = out.frontier + lowest
    target: Pose | None = None
    goals: tuple[Goal, ...] = ()
    if back is None:
        energies = table.min(axis=0) + rise
    else:
        several = replace(problem, goal=back)
        target, goals = several.goal, several.goals
        ways = np.full_like(table, np.inf)
        for home in _homes(several, lattice):
            setting = _reversed(priced(home.query.setting))
            search = _search(setting, lattice, energy - lowest, effort, home.roots)
            np.minimum(ways, _table(search, lattice, spacing, setting), out=ways)
            complete = min(complete, search.frontier + lowest)
        # the energy of climbing on the way out returns on the way home, but for the two ends
        level = there.height_potential(target) - there.height_potential(problem.start)
        energies = (table + ways).min(axis=0) + level
    if upper is not None:
        energies = upper.whole(energies)
    cut = np.any(energies[np.isfinite(energies)] > energy)
    if cut or np.isfinite(complete):
        complete = min(complete, energy)
    return EnergyMap(
        energy=np.where(energies <= energy, energies, np.inf), resolution=spacing,
        origin=there.grid.origin, start=problem.start, back=target, complete_to=complete,
        confidence=confidence, goals=goals,
    )  # fmt: skip


class _Home(NamedTuple):
    """Poses to get back to whose headings are on one lattice."""

    query: CompiledProblem  # whose start is one of them
    roots: tuple[kernels.Root, ...]  # all of them; none where that is the only one


def _homes(problem: PlanningProblem, lattice: kernels.Lattice) -> Iterator[_Home]:
    """Yield the free poses of the problem's goals; each costs the climb to it from the goal."""
    if not problem.goals:
        yield _Home(compiled(replace(problem, start=problem.goal)), ())
        return
    grid, turn, found = problem.terrain.obstacles, lattice.turn, False
    yaws = [goal.yaw for goal in problem.goals if goal.yaw is not None] or [0.0]
    for k, offset in enumerate(dict.fromkeys(yaw % turn for yaw in yaws)):
        fitting = [
            _poses(goal, lattice, offset)
            for goal in problem.goals
            if (k == 0 if goal.yaw is None else goal.yaw % turn == offset)
        ]
        each = np.concatenate(fitting)
        each = each[grid.inside(each[:, :2])]
        each = each[grid.footprint_free(each, problem.robot)]
        if len(each) == 0:
            continue
        found = True
        poses = [Pose(*one) for one in each.tolist()]
        query = compiled(replace(problem, start=poses[0], goal=poses[0], goals=()))
        level = query.height_potential(problem.goal)
        headings = np.round((each[:, 2] - poses[0].yaw) / turn).astype(int) % lattice.headings
        roots = (
            kernels.Root(*query.centre(pose)[:2], heading, query.height_potential(pose) - level)
            for pose, heading in zip(poses, headings.tolist(), strict=True)
        )
        yield _Home(query, tuple(roots))
    if not found:
        raise none_free(problem)


def _poses(goal: Goal, lattice: kernels.Lattice, offset: float) -> FloatArray:
    """Return poses of a goal, shape (n, 3): of a circle, those all over it."""
    rings = np.append(np.arange(lattice.cell, goal.radius, lattice.cell), goal.radius)
    return np.concatenate([
        replace(goal, radius=radius).samples(
            lattice.headings, int(np.ceil(2.0 * np.pi * radius / lattice.cell)), offset
        )
        for radius in rings.tolist()
    ])  # fmt: skip


def _search(
    setting: KernelProblem,
    lattice: kernels.Lattice,
    limit: float,
    effort: int,
    roots: Sequence[kernels.Root] = (),
) -> Search:
    """Return a search grown up to an energy."""
    search = Search(setting, no_cost_to_go(), lattice, 0.0, roots)
    budget, status = Budget(effort=effort), kernels.RUNNING
    while status == kernels.RUNNING and search.frontier <= limit and not budget.over:
        status = search.run(budget, STRIDE)
    return search


def _reversed(setting: KernelProblem) -> KernelProblem:
    """Return a problem in which each motion costs what it does driven the other way."""
    half = DIRECTIONS // 2
    mirrored = np.concatenate([setting.prices[:, half:-1], setting.prices[:, : half + 1]], axis=1)
    return setting._replace(prices=np.ascontiguousarray(mirrored), gear=-setting.gear)


def _table(
    search: Search, lattice: kernels.Lattice, spacing: float, setting: KernelProblem
) -> FloatArray:
    """Return the least energy by heading and place, shape (headings, rows, columns)."""
    space, tree = setting.space, search.tree
    count = int(tree.counts[0])
    live = np.isfinite(tree.g[:count])
    x, y = tree.x[:count][live] - space.x, tree.y[:count][live] - space.y
    rows, columns = _shape(setting, spacing)
    column = np.clip((space.cos * x + space.sin * y) / spacing, 0, columns - 1).astype(int)
    row = np.clip((-space.sin * x + space.cos * y) / spacing, 0, rows - 1).astype(int)
    yaw = search.setting.start.yaw + tree.heading[:count][live] * lattice.turn - space.yaw
    heading = np.round(yaw / lattice.turn).astype(int) % lattice.headings
    out = np.full((lattice.headings, rows, columns), np.inf)
    np.minimum.at(out, (heading, row, column), tree.g[:count][live])
    return out


def _shape(setting: KernelProblem, spacing: float) -> tuple[int, int]:
    rows, columns = np.ceil(
        np.array(setting.space.clearance.shape) * setting.space.resolution / spacing
    )
    return int(rows), int(columns)


def _rise(query: CompiledProblem, spacing: float) -> FloatArray:
    """Return the potential energy of the height of each place above the start's [J]."""
    rows, columns = _shape(query.setting, spacing)
    rise = np.zeros((rows, columns))
    if query.problem.heights is None:
        return rise
    scale = spacing / query.grid.resolution
    size = np.array(query.grid.shape[::-1])
    start = query.height_potential(query.problem.start)
    for row, column in np.ndindex(rows, columns):
        middle = np.minimum(np.array([column + 0.5, row + 0.5]) * scale, size)
        x, y = query.grid.to_world(middle).tolist()
        rise[row, column] = query.height_potential(Pose(x, y, 0.0)) - start
    return rise
