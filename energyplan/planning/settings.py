"""How the stages of planning are set: one record a stage."""

from __future__ import annotations

from typing import NamedTuple


class RouteTracking(NamedTuple):
    """Constants of turning a route into motions."""

    back: tuple[int, ...] = (1, 2, 3, 5, 8, 13, 21)  # how many poses back a pose is joined to
    stride: float = 0.5  # distance between poses over the room at them [1]
    beyond: tuple[int, ...] = (8, 20)  # poses that a short search leads further
    # lattices of that search: scale, expansions
    across: tuple[tuple[float, int], ...] = ((1.0, 600), (0.25, 1500))


TRACKING = RouteTracking()


class RouteSearch(NamedTuple):
    """Constants of the search for routes among free configurations."""

    near: float = 12.0  # distance to the goal from which the cost-to-go leads on [cells]
    weight: float = 1.1  # factor on the heuristic
    again: float = 1.4  # factor on the price of a step near an earlier route
    blocked: float = 8.0  # the same where tracking was stuck
    most: int = 4  # routes
    # factors on the price of turns for routes of long straight steps [1]
    turns: tuple[float, ...] = (1.0, 3.0)
    hope: float = 1.03  # cost over the best path's up to which these are refined [1]
    spare: int = 1024  # room for the states that one leads to
    states: int = 100_000  # states that are expanded at most
    wide: float = 9.0  # room beyond the body's reach from which steps are four cells long [cells]
    aside: float = 1.01  # sectors that a step may lead aside of the facing [1]


ROUTES = RouteSearch()


class LatticeSearch(NamedTuple):
    """Constants of the weighted A* over a state lattice."""

    tolerance: float = 0.15  # error of the first heading of the route [rad]
    headings: int = 32  # headings of the coarsest lattice
    most_headings: int = 512  # headings of a finer lattice, at most
    cell: float = 0.2  # size of a cell over the body's reach, where the map's are smaller [1]
    step: float = 1.5  # length of a straight motion [cells]
    far_scale: float = 1.5  # cell and step of the search for many goals, over those for one [1]
    far_headings: int = 24  # headings of the search for many goals
    coarse: float = 2.0  # scale of the lattice that compares routes through open ground
    alike: float = 0.2  # gain for which a cell is not entered again [cells]
    lead: float = 0.2  # part of the cost to go that expansions make up for until the goal is tried
    neighbours: float = 0.973  # distance over that along 16 neighbours, at least [1]
    less: float = 1e-6  # share of the cost by which a further path has to be cheaper
    hope: float = 1.08  # cost over the best path's that refinement may still make up for [1]
    slice: int = 500  # expansions between two looks at the budget
    weight: float = 2.0  # factor on the heuristic where any path will do


LATTICE = LatticeSearch()


class Refining(NamedTuple):
    """Constants of shortcuts and random refinement, and of dividing the budget among paths."""

    poses: int = 60  # poses of a path, where its motions are no more
    spare: int = 20  # poses beyond the motions of a path, at least
    piece: float = 0.2  # length of the shortest motions [m]
    pivot: float = 0.3  # turn of the smallest motions [rad]
    span: int = 150  # largest index difference of poses that a shortcut joins
    near: int = 5  # the same at first where a path has more poses than `apart`
    fewer: float = 0.7  # share of the poses that is left above which that difference is doubled
    hopeless: int = 8  # poses in a row without a free shortcut after which none is tried
    clear: float = 1e-3  # share of the cost that a shortcut saves unless it is not free
    insert: float = 0.02  # probability that a pose is inserted
    remove: float = 0.06  # probability that a pose is removed
    merge: float = 0.2  # probability that one replaces two, where stops have a price
    first: float = 0.3  # distance by which a pose is moved at first [m]
    anew: float = 0.2  # the same after the smallest [m]
    smallest: float = 1e-4  # least distance by which poses are moved [m]
    aligned: float = 1e-5  # half the difference of headings below which they are one [rad]
    largest: float = 1.0  # largest distance by which poses are moved [m]
    longer: float = 1.6  # factor on the distance after a success
    shorter: float = 0.96  # factor on the distance after a failure
    shift: float = 0.7  # probability that a moved pose changes its place
    turn: float = 0.7  # probability that a moved pose changes its heading
    trials: int = 400  # attempts of a turn, and between two looks at the budget
    patience: int = 4000  # attempts without a gain until a path is left
    gain: float = 1e-4  # share of the cost that counts as one
    opening: float = 500.0  # units of work of a path's first turn, with its shortcuts
    step: float = 300.0  # units that each step that follows takes at most
    kept: int = 4  # paths that stay in the portfolio
    hope: float = 1.03  # cost over the best one above which a path is given up [1]
    same: float = 1e-9  # share of the cost by which paths differ that count as two


REFINING = Refining()


class FewerStops(NamedTuple):
    """Constants of the search for paths with fewer stops."""

    least: float = 1e-3  # part of the objective that stops take from which they have a price
    most: float = 0.03  # part of the objective from which other routes are searched
    # prices of a stop for paths near the best one, over the one that paths are searched with [1]
    prices: tuple[float, ...] = (3.0, 0.0)
    polish: int = 800  # attempts to refine such a path


STOPS = FewerStops()


class MovingTurns(NamedTuple):
    """Constants of turns that are driven at speed."""

    step: float = 0.25  # largest jump of the treads' difference between two arcs [1]
    widest: float = 2.8  # turn from which two lines are not joined [rad]
    parallel: float = 0.05  # sine of the angle below which two lines do not meet
    still: float = 1e-6  # distance below which a turn is one on the spot [m]
    rounds: int = 60  # rounds in which the headings of lines between turns are found
    exact: float = 1e-12  # error of these [rad]
    # slopes of all turns at first, over that at which one tread goes on at its top speed [1]
    slopes: tuple[float, ...] = (1.0, 2.0)
    sharper: float = 2.0  # factor on the slope of a turn that is not free [1]
    out: tuple[float, ...] = (0.0, 1.0)  # how far a turn is moved outwards before that [1]
    levels: int = 8  # shapes that are tried before a turn stays as it is
    first: float = 2.0  # factor by which slopes are changed at first [1]
    last: float = 1.15  # the same at last [1]
    gain: float = 2e-3  # share of the objective gained in a round below which it becomes smaller


MOVING_TURNS = MovingTurns()


class Lane(NamedTuple):
    """How much of the work after the first path is of one kind."""

    share: float  # part of all work [1]
    begins: float = 0.0  # units of all work after which it begins
    units: float = 0.0  # units of its first step
    divisible: bool = False  # whether a step that is cut short is of use


class Stages(NamedTuple):
    """Work after the first path. It does not depend on the budget, which only ends it."""

    refining: Lane = Lane(0.3, divisible=True)
    routes: Lane = Lane(0.25, units=300.0)
    straight: Lane = Lane(0.1, units=150.0)
    compared: Lane = Lane(0.06, 600.0, 75.0)
    turning: Lane = Lane(0.1, 600.0, 300.0)
    shortening: Lane = Lane(0.08, 1000.0, 250.0, divisible=True)
    bound: Lane = Lane(0.15, 800.0, 200.0)
    passages: Lane = Lane(0.06, 4000.0)
    driving: Lane = Lane(0.15, 1000.0)
    varying: Lane = Lane(0.1, 2000.0)
    moving: Lane = Lane(0.2, 600.0)
    anew: float = 0.97  # part of the cost below which a better path gets turns at speed at once
    gap: float = 0.03  # gap up to which a default effort is enough, and no more is advised
    gain: float = 1e-3  # share of the cost that has to be gained for it to go on
    least_bound: float = 200.0  # units for the lower bound at first, whatever is left


STAGES = Stages()


class Rejoining(NamedTuple):
    """Constants of replanning; lengths in half slip tracks."""

    # how far ahead a path is joined again
    ahead: tuple[float, ...] = (0.0, 0.1, 0.3, 0.6, 1.25, 2.5, 5.0, 10.0, 20.0)
    step: float = 0.1  # distance between the poses looked at [half slip tracks]
    turn: float = 0.05  # turn between them [rad]
    alike: float = 1e-9  # distances that are equal [m]


REJOINING = Rejoining()


class Narrow(NamedTuple):
    """Routes through passages that the poses tested do not show."""

    least: float = 800.0  # units of work below which none is searched for
    costs_to_go: float = 6.0  # the same, in units of what the known cost-to-go took
    gain: float = 0.98  # length over the known route's above which a route is not tracked [1]


NARROW = Narrow()


class ToGo(NamedTuple):
    """The cost-to-go over the nodes of the free configurations."""

    rounding: float = 1e-3  # distances that differ by less are equal [cells]
    block: int = 8  # places along either side of a region's block
    ahead: float = 1.2  # how far ahead at least the direction of the route is looked up [m]
    ahead_at_most: float = 1.875  # how far ahead it may be kept from the next node [m]
    corridor: float = 1.05  # length of the routes that the corridor holds, over the shortest's [1]
    slack: float = 1.0  # extra length of them [body lengths]


TO_GO = ToGo()


class Bidirectional(NamedTuple):
    """Constants of the search through a passage from both of its ends."""

    cell: float = 0.125  # its cells over those of the route [1]
    spare: tuple[float, ...] = (0.5, 0.0)  # how much larger the body is in it [cells]
    wide: float = 3.0  # how much larger it is where it has room [cells]
    most: int = 20_000  # poses tested at most, and motions along them
    aside: float = 4.0  # factor on the length of a step to the side [1]
    tight: float = 3.0  # factor on the length of a step where the body has no room [1]
    longest: int = 64  # poses that a motion along them leads further at most
    halvings: int = 8  # how often the motion between two poses is halved until it is free


PASSAGE = Bidirectional()


class Proving(NamedTuple):
    """Constants of the proof that there is no path."""

    safe: float = 1e-5  # shrinkage of a body whose collision is certain, above rounding [cells]
    finest: float = 2.5e-3  # distance between poses at which halving boxes ends [m]
    part: float = 0.1  # the same at least [cells]
    places: int = 1  # places about an unknown step whose boxes are halved as well
    headings: int = 2  # headings about it


PROOF = Proving()


class Configurations(NamedTuple):
    """Constants of the free configurations."""

    fineness: float = 0.16  # distance between places over the body's smaller side [1]
    coarsest: float = 0.35  # the same at most [1]
    places: int = 1_000_000  # places beyond which the distance between them grows
    bands: int = 64  # bands of rows into which the work is cut


FREE = Configurations()


class SlopePrices(NamedTuple):
    """Constants of prices on slopes."""

    finer: int = 4  # slopes between two of the table at which height is priced as well
    remembered: int = 16  # tables that are kept for a cost
    slopes: int = 9  # slopes at which prices are scanned
    zooms: int = 20  # rounds in which the cheapest slope is enclosed
    cuts: int = 3  # slopes tried in each


SLOPES = SlopePrices()


class Outlines(NamedTuple):
    """Constants of the outlines of obstacles."""

    bucket: int = 8  # side of the squares by which edges are looked up [cells]
    directions: int = 512  # directions by which it is noted how far one sees
    tiny: float = 1e-9  # distance by which a line may miss a corner and still touch it [m]
    difference: float = 1e-8  # least difference of a level and a clearance [1]
    cells: int = 1 << 21  # cells whose contours are computed at once


OUTLINES = Outlines()


class Gates(NamedTuple):
    """Constants of the gates at the ends of a line of the bound."""

    step: float = 0.02  # distance between the places tried on a gate [m]
    long: float = 3.0  # length from which a gate forbids no heading [m]
    endless: float = 10.0  # length from which a gate has no end [m]


GATES = Gates()


class BoundSearch(NamedTuple):
    """Constants of the lower bound."""

    corners: int = 2500  # corners near short paths above which a coarser outline is used
    # lengths over the straight line's for which outlines are prepared
    detours: tuple[float, float] = (1.1, 2.0)
    beyond: float = 1.001  # cost over the best path's up to which it is searched for [1]
    regions: int = 400  # discs into which one about a goal is divided at most
    smaller: float = 0.5  # radius of the disc in the body beside obstacles at the goal [1]


BOUND = BoundSearch()


class Escaping(NamedTuple):
    """Constants of the search out of tight ends."""

    parts: tuple[float, ...] = (1.0, 0.5, 0.2)  # parts of the longest free motion that are tried
    halvings: int = 16  # how often a motion is halved until it is free
    closer: int = 3  # how often the interval between free and not free is halved then
    spare: float = 0.999  # part of a free motion that is driven, so that no rounding makes it touch
    doubling: float = 4.0  # path length that doubling the room makes up for [reaches]
    fineness: float = 0.25  # cells in which poses are one, over what the corners can move [1]
    # longer ways that gaining the whole clearance makes up for, tried in turn [reaches]
    clearing: tuple[float, ...] = (0.5, 2.0, 16.0)
    parts_of_clearance: int = 5  # halvings, until what a pose has of the clearance is known
    turn: float = 0.2  # turn on the spot, both ways together, that makes room [rad]
    ways: int = 6  # paths out of an end, of which the best is used
    effort: float = 3000.0  # units of work for each end at most
    nodes: int = 1 << 13  # poses that the search keeps


ESCAPE = Escaping()


class SeveralGoals(NamedTuple):
    """Constants of planning to one of several poses."""

    headings: int = 48  # of those that are all allowed that are looked at
    around: int = 16  # places on the edge of a circle that are looked at
    ranking: float = 0.15  # share of the budget for routes to poses
    routes: int = 3  # routes to a place at any heading
    tries: int = 4  # poses of a goal that are planned to until one is reached
    trial: float = 0.12  # share of the budget for a first plan to a pose
    kept: float = 3.0  # such shares that are kept for refining
    close: float = 1.01  # cost over the best one's up to which a plan is refined [1]
    finalists: int = 2  # plans that are refined
    others: int = 3  # other headings of the best goal that are planned to
    promising: float = 1.05  # cost of the route to one of these over the best plan's, at most
    possible: float = 1.2  # the same for another goal
    span: float = 0.6  # difference of headings that deserve a plan of their own [rad]
    ends: int = 60  # poses of a path from which another end is tried
    near: float = 10.0  # distance of these from the end [reaches of the body]
    hopeless: int = 4  # ends that one of these is not joined to until it is given up
    less: float = 1e-6  # share of the cost by which another end has to be cheaper
    zooms: int = 4  # rounds in which headings lie closer to the best one
    parts: int = 8  # into which the distance between headings is divided in each


SEVERAL = SeveralGoals()
