"""What the commands print for people: results as lines of text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from energyplan.html import number, words
from energyplan.output.documents import terms

if TYPE_CHECKING:
    from energyplan.comparison import Comparison
    from energyplan.diagnosis import Diagnosis
    from energyplan.errors import NoPathError
    from energyplan.fit import ICREstimate, Identification
    from energyplan.fit.identification import InternalFriction
    from energyplan.io.logs import LogInfo
    from energyplan.io.start import Start
    from energyplan.limits.feasibility import FeasibilityReport
    from energyplan.live import Event
    from energyplan.mission import FleetReport, MissionReport
    from energyplan.physics import Driven, Loop
    from energyplan.physics.design import Design
    from energyplan.planning import Plan
    from energyplan.planning.driven import DrivenPath
    from energyplan.power import PowerModel
    from energyplan.reach import Contour, EnergyMap


def identification(found: Identification) -> list[str]:
    """Return what ``energyplan identify`` prints."""
    lines = []
    for row in terms(found.model):
        low, high = found.interval(row["name"])
        lines.append(
            f"{row['name'].replace('_', ' ')}: {row['symbol']} = {number(row['value'])} "
            f"+- {number(row['std_error'], 2)} {_unit(row['unit'])}".rstrip()
            + f" (95 %: {number(low)} to {number(high)})"
        )
    icr, spread = found.icr, found.icr_std_error
    error = "kept from the vehicle" if spread is None else f"+- {number(spread['left'], 2)}"
    lines.append(f"tread ICRs: left {number(icr.left)} m, right {number(icr.right)} m, {error}")
    misfit = found.residual
    lines.append(
        f"residual: rmse {number(misfit.rmse)} W, mae {number(misfit.mae)} W, bias "
        f"{number(misfit.bias)} W, energy {100 * misfit.energy_error:+.2f} %"
    )
    if found.foretold is not None:
        lines.append(f"unseen driving: {found.foretold.in_words}")
    lines += _set_aside(found.set_aside)
    lines += [f"note: {warning}" for warning in found.warnings]
    return lines


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _set_aside(counts: Mapping[str, Mapping[str, int]]) -> list[str]:
    drives: dict[str, dict[str, int]] = {}
    for drive, reasons in counts.items():
        for reason, count in reasons.items():
            drives.setdefault(reason, {})[drive] = count
    return [
        f"set aside in {listed(list(of))}: {sum(of.values())} samples: {reason}"
        for reason, of in drives.items()
    ]


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence gives them; of many the first two, and how many there are more."""
    if len(names) <= 3:
        return ", ".join(names)
    return f"{', '.join(names[:2])} and {len(names) - 2} more"


def diagnosis(told: Diagnosis) -> list[str]:
    """Return what ``energyplan diagnose`` prints."""
    lines = [f"verdict: {told.verdict.replace('_', ' ')}"]
    for effect in told.effects:
        lines.append(
            f"effect: {effect.name.replace('_', ' ')}, {effect.symbol} = {number(effect.value)} "
            f"+- {number(effect.std_error, 2)} {effect.unit}"
        )
        lines[-1] += f", probability {effect.probability:.2f}"
        if effect.rivals:
            rivals = ", ".join(map(words, effect.rivals))
            lines.append(f"  these drives cannot separate it from: {rivals}")
    others = [one for one in told.explanations[1:] if one.probability >= 0.01]
    lines += [
        f"or, with probability {one.probability:.2f}: "
        + (" and ".join(name.replace("_", " ") for name in one.effects) or "no effect")
        for one in others
    ]
    for name, misfit in (("before", told.before), ("after", told.after)):
        lines.append(
            f"hold-out {name}: rmse {number(misfit.rmse)} W, mae {number(misfit.mae)} W, "
            f"energy {100 * misfit.energy_error:+.2f} %"
        )
    lines += [
        f"{one.drive}: {number(one.energy)} J predicted (90 % interval "
        f"{number(one.energy_interval[0])} to {number(one.energy_interval[1])}), "
        f"{number(one.measured)} J measured"
        for one in told.predictions
    ]
    quality = told.adequacy
    lines.append(
        f"residual on the training drives: {number(quality.residual)} W; noise: "
        f"{number(quality.noise)} W"
        + ("; the residual lasts longer than noise does" if quality.coloured else "")
    )
    lines += _set_aside(told.set_aside)
    lines += [
        f"unexplained: {found.channel} ({found.shape}), "
        f"{100 * found.explained_variance:.0f} % of the residual's variance"
        for found in told.unexplained
    ]
    lines += [f"advice: {advice}" for advice in told.advice]
    return lines


def hoisted(sides: Sequence[InternalFriction]) -> list[str]:
    """Return what ``energyplan identify --hoisted`` prints."""
    lines = []
    for side in sides:
        lines.append(
            f"friction inside the {side.side} side: {number(side.force)} +- "
            f"{number(side.force_error, 2)} N at {number(side.speed)} m/s, changing by "
            f"{number(side.slope)} +- {number(side.slope_error, 2)} N per m/s"
        )
        lines += [
            f"  {number(one.speed)} m/s: {number(one.force)} +- {number(one.std_error, 2)} N"
            for one in side.classes
        ]
        if side.left_out:
            lines.append(f"  {side.left_out} samples in the sensor's dead band: half of it used")
    return lines


def start(made: Start) -> list[str]:
    """Return what ``energyplan start`` prints."""
    project = made.project
    topics = {} if project.topics is None else project.topics.channels
    lines = [
        f"{channel}: {f'{one.topic} {one.written}'.strip()}"
        f"{f' [{one.unit}]' if one.unit and not one.field.endswith(f'[{one.unit}]') else ''}"
        for channel, one in {
            **project.columns,
            **{c: many[0] for c, many in topics.items()},
        }.items()
    ]
    lines += [f"assumed {what}: {value}" for what, value in project.defaults.items()]
    for check in made.checks:
        lines.append(f"{'ok' if check.ok else 'WRONG'}: {check}")
    return [*lines, *(f"note: {note}" for note in made.notes)]


def icr(found: ICREstimate) -> list[str]:
    """Return what ``energyplan identify --spin`` prints."""
    lines = [
        f"{name}: {number(getattr(found.icr, name), 4)} m +- {number(error, 2)}"
        for name, error in found.std_error.items()
    ]
    return [*lines, f"from {found.source}, {number(found.turning)} rad of turning"]


def event(told: Event) -> list[str]:
    """Return the line of an event of ``energyplan watch``."""
    from energyplan.live import Changed, Done, Learned, Reassessed, Trouble

    if isinstance(told, Trouble):
        often = f" ({told.count} times more)" if told.count > 1 else ""
        return [f"{told.place}: {told.reason}{often}"]
    if isinstance(told, Learned):
        factor = f"; {number(told.factor, 3)} times former runs" if told.factor != 1.0 else ""
        return [f"{told.t:.1f} s: {_coefficients(told.model)}; {told.samples} samples{factor}"]
    if isinstance(told, Changed):
        return [
            f"{told.t:.1f} s: the ground changed about {told.onset:.1f} s (chi-squared "
            f"{number(told.statistic)}); it was {_coefficients(told.before)}"
        ]
    if isinstance(told, Done):
        return [f"{told.t:.1f} s: task {told.task} is done"]
    if isinstance(told, Reassessed):
        report = told.report
        said = "all tasks are done" if report is None else "; ".join(mission(report))
        return [f"{told.t:.1f} s: charge {100 * told.soc:.1f} %; {said}"]
    aside = ", ".join(f"{count} x {reason}" for reason, count in told.set_aside.items())
    return [
        f"the end: {told.samples} samples, {told.changes} changes of ground"
        + (f"; reported: {aside}" if aside else "")
    ]


def _coefficients(model: PowerModel) -> str:
    return ", ".join(
        f"{row['symbol']} = {number(row['value'])}"
        + ("" if row["std_error"] is None else f" +- {number(row['std_error'], 2)}")
        + f" {_unit(row['unit'])}".rstrip()
        for row in terms(model)
    )


def driven_path(made: Plan, told: DrivenPath | None) -> list[str]:
    """Return what driving a plan takes, beside what its path takes."""
    if told is None:
        return []
    more = told.energy - made.energy
    parts = {
        name: joules - made.breakdown.get(name, 0.0) for name, joules in told.breakdown.items()
    }
    telling = [
        f"{name.replace('_', ' ')} {'+' if joules > 0 else '-'}{number(abs(joules))} J"
        for name, joules in parts.items()
        if abs(joules) > 0.002 * abs(told.energy)
    ]
    beside = "as much as"
    if abs(more) > 1e-4 * abs(told.energy):  # what the energies, to five digits, show
        beside = f"{number(abs(more))} J {'more' if more >= 0 else 'less'} than"
    return [
        f"driven: {number(told.energy, 5)} J in {number(told.duration)} s at "
        f"{number(told.speed)} m/s, {beside} the path at steady speed"
        + (f" ({', '.join(telling)})" if telling else "")
    ]


def plan(made: Plan, objective: str) -> list[str]:
    """Return what ``energyplan plan`` prints; bound and gap are those of the objective."""
    unit = {"energy": "J", "length": "m", "time": "s"}[objective]
    parts = ", ".join(f"{k.replace('_', ' ')} {number(v)} J" for k, v in made.breakdown.items())
    height = f", {number(made.potential, 5)} {unit} of it for the height" if made.potential else ""
    soft = f"costmap: {number(made.soft_cost, 5)} {unit} beside the {objective}"
    what = f"{objective} and costmap" if made.soft_cost else objective
    return [
        f"energy: {number(made.energy, 5)} J ({parts})",
        *([soft] if made.soft_cost else []),
        f"{what} at most {round(100 * made.gap, 1) + 0.0:.1f} % above the least possible "
        f"(lower bound {number(made.lower_bound, 5)} {unit}{height})",
        f"length: {number(made.length)} m, turning: {number(math.degrees(made.turning))} deg",
        f"planned by {made.planner} in {made.planning_time:.2f} s, effort {made.effort}",
        *(f"note: {note}" for note in made.notes),
    ]


def no_path(error: NoPathError) -> list[str]:
    """Return what ``energyplan plan`` prints where there is no path."""
    proven = error.certainty == "proven"
    return [f"{'there is no path' if proven else 'no path was found'}: {error}"]


def comparison(made: Comparison) -> list[str]:
    """Return what ``energyplan compare`` prints."""
    lines = ["least energy:", *(f"  {line}" for line in plan(made.energy_optimal, "energy"))]
    lines += ["shortest:", *(f"  {line}" for line in plan(made.shortest, "length"))]
    how = ", both driven with their stops" if made.driven else ""
    lines.append(f"saving: {100 * made.saving:.1f} % of the shortest route's energy{how}")
    return lines


def energy_map(found: EnergyMap, areas: Sequence[Contour]) -> list[str]:
    """Return what ``energyplan range`` prints."""
    way = "there" if found.back is None else "there and back"
    sure = "" if found.confidence is None else f" (at {100 * found.confidence:g} % confidence)"
    lines = [
        f"with {number(a.energy, 4)} J the robot gets {way} on {number(a.area.area)} m^2{sure}"
        for a in areas
    ]
    if not lines:
        lines = ["no place can be reached with this energy"]
    if math.isfinite(found.complete_to):
        lines.append(
            f"places that take more than {number(found.complete_to, 4)} J were not searched"
        )
    return lines


def feasibility(report: FeasibilityReport) -> list[str]:
    """Return what ``energyplan check`` prints."""
    lines = ["feasible" if report.feasible else "not feasible"]
    lines += [
        f"{found.kind.replace('_', ' ')} {found.side}: {number(found.start)} s to "
        f"{number(found.end)} s, peak {number(found.peak)}, limit {number(found.limit)}"
        + (f" ({number(100 * (found.peak / found.limit - 1), 2)} % more)" if found.limit else "")
        for found in report.violations
    ]
    return [*lines, report.reason, f"energy: {number(report.energy)} J"]


def mission(told: MissionReport) -> list[str]:
    """Return what ``energyplan mission`` prints."""
    tables = [line for one in told.tables for line in one.text().splitlines()]
    return [told.sentence, *(f"warning: {warning}" for warning in told.warnings), *tables]


def fleet(told: FleetReport) -> list[str]:
    """Return what ``energyplan mission`` prints of several robots."""
    count = len(told.fleet.tasks)
    done = count - len(told.left_out)
    if told.proven:
        quality = "no better assignment exists"
    elif math.isfinite(told.gap):
        quality = f"at most {100 * told.gap:.0f} % of its energy could be saved"
    else:
        quality = "how much could be saved is not known"
    lines = [
        f"{done} of {count} tasks are done: {'feasible' if told.feasible else 'not feasible'}; "
        f"{quality}"
    ]
    for robot in told.robots:
        lines.append(
            f"{robot.name}: {number(robot.energy / 3600)} Wh, at most "
            f"{number(robot.energy_upper / 3600)} Wh; {robot.duration:.0f} s; state of charge at "
            f"the end {100 * robot.soc_end:.0f} %, at least {100 * robot.soc_end_lower:.0f} %"
        )
        lines += [
            f"  {stop.arrival:.0f} s {stop.kind}: {stop.name}"
            + (f" until {stop.departure:.0f} s" if stop.departure > stop.arrival else "")
            for stop in robot.route[1:]
        ]
    for task in told.left_out:
        lines.append(f"{task.name}: nobody does it ({', '.join(task.reasons)})")
    return lines


def log(told: LogInfo) -> list[str]:
    """Return what ``energyplan start`` prints without ``--out``: columns or topics, then notes."""
    wide = max((len(entry.name) for entry in told.entries), default=0)
    length = f"{told.duration:.1f} s" if told.duration > 0 else "of unknown length"
    lines = [f"{told.name}: {told.kind}, {length}"]
    for entry in told.entries:
        rate = f", {entry.rate:.1f} Hz" if entry.rate else ""
        serves = f"  -> {entry.serves}" if entry.serves else ""
        lines.append(f"  {entry.name:{wide}}  {entry.type}, {entry.count} readings{rate}{serves}")
    lines += [f"{name}: {', '.join(found) or 'none'}" for name, found in told.channels.items()]
    return [*lines, *(f"note: {note}" for note in told.notes)]


def driven(made: Driven, secret: bool = False) -> list[str]:
    """Return what ``energyplan drive`` prints; `secret` leaves out what was taken by term."""
    lines = [
        f"energy predicted: {number(made.energy_told, 5)} J, "
        f"measured: {number(made.energy_taken, 5)} J ({100 * made.error:+.2f} %)"
    ]
    for name, told, taken in made.terms:
        if told or not secret:
            after = "" if secret else f", measured {number(taken)} J"
            lines.append(f"  {name.replace('_', ' ')}: predicted {number(told)} J{after}")
    lines.append(
        f"{'arrived' if made.arrived else 'not arrived'}: {100 * made.final_error:.1f} cm from the "
        f"end; at most {100 * made.tracking_error:.1f} cm and "
        f"{math.degrees(made.heading_error):.1f} deg off on the way"
    )
    return lines


def loop(made: Loop) -> list[str]:
    """Return what ``energyplan close-the-loop`` prints."""
    lines = []
    for k, now in enumerate(made.rounds, 1):
        span = ""
        if now.energy_interval:
            span = " ({} to {} J)".format(*(number(value, 5) for value in now.energy_interval))
        lines.append(
            f"round {k}: route of {number(now.length)} m, predicted "
            f"{number(now.energy_told, 5)} J{span}, measured {number(now.energy_taken, 5)} J "
            f"({100 * now.error:+.1f} %)"
        )
        if now.survey:
            duration = now.survey.trajectory.duration
            lines.append(f"  a designed drive of {duration:.0f} s was made to learn from")
        lines += [
            f"  found: {e.name.replace('_', ' ')}, {number(e.value)} +- {number(e.std_error, 2)} "
            f"{e.unit}"
            for e in now.effects
        ]
        lines += [f"  {now.note}"] if now.note else []
    return [*lines, f"the last prediction {_verdict(made)}"]


def _verdict(made: Loop) -> str:
    """Return what became of the last prediction of a loop."""
    if made.closed:
        return "was right"
    last = made.rounds[-1]
    if last.energy_interval:
        low, high = last.energy_interval
        if low <= last.energy_taken <= high:
            return "holds the energy taken, but is too wide to count as right; drive more rounds"
    return "was still wrong"


def design(made: Design) -> list[str]:
    """Return what ``energyplan design`` prints."""
    expected = [
        f"if it is {label}: {100 * value:.0f} % sure of it after the drive"
        for label, value in made.probabilities_expected
    ]
    return [f"{made.trajectory.duration:.0f} s: {made.sentence}", *expected]
