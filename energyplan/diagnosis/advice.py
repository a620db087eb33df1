"""What to do next, in sentences (private)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

from energyplan.diagnosis.residual import Dependence
from energyplan.diagnosis.result import FoundEffect
from energyplan.fit.adequacy import Adequacy
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Residual
from energyplan.power.effects import Effect

_MEAN_OF_NORMAL = (2 / pi) ** 0.5
"""Mean size of a normal variable over its standard deviation."""

_MASSES = ("grade", "linear_inertia", "specific_force")


def small_advice(names: Sequence[str]) -> list[str]:
    """Name what may well be there, and is too small or too weakly shown to be named."""
    if not names:
        return []
    some = " or ".join(_plain(name) for name in names)
    return [
        f"there may be a little of {some}: too little here to be told from noise or from an "
        "imperfection of the other effects; drive longer where it would be largest"
    ]


def rival_advice(found: Sequence[FoundEffect], entries: Mapping[str, Effect]) -> list[str]:
    """Name the manoeuvre that separates each effect from its rivals."""
    lines = []
    for effect in found:
        if not effect.rivals:
            continue
        names = " or ".join(_plain(name) for name in effect.rivals)
        ways = [entries[name].manoeuvre for name in (effect.name, *effect.rivals)]
        told = "; ".join(dict.fromkeys(way for way in ways if way))
        lines.append(
            f"these drives cannot separate {_plain(effect.name)} from {names}; "
            f"to separate them: {told}"
        )
    return lines


def adequacy_advice(quality: Adequacy, named: bool) -> list[str]:
    """Say that something is missing where more than noise is left."""
    if quality.adequate:
        return []
    line = f"the model leaves, on the training drives, {quality.in_words}, so something is missing"
    return [line if named else f"{line}, and no recorded channel explains it"]


def worse_advice(
    effects: Sequence[str], before: Residual, after: Residual, known: Residual
) -> list[str]:
    """Say that the hold-out drives are predicted worse than without any effect, and why.

    `known` is the error with what the total of these drives shows of what contacts hold.
    """
    if not effects or after.rmse <= before.rmse:
        return []
    names = ", ".join(_plain(name) for name in effects)
    line = (
        f"the hold-out drives are predicted worse with {names} (rmse {after.rmse:.3g} W) than "
        f"without ({before.rmse:.3g} W): "
    )
    if known.rmse < before.rmse:
        return [
            f"{line}near straight driving their contacts hold a moment that costs power, which no "
            f"prediction knows; with what their own power shows of it the rmse is {known.rmse:.3g} "
            "W. Log yaw_rate, and the power of both sides"
        ]
    return [f"{line}they differ from the training drives; record more of both"]


def unheld_advice(effects: Sequence[str], quality: Adequacy, after: Residual) -> list[str]:
    """Say that what was found, if anything, does not hold on the drives that took no part."""
    names = ", ".join(_plain(name) for name in effects) or "resistance and friction alone"
    return [
        f"{names} fit the training drives (rmse {quality.residual:.3g} W) and not the hold-out "
        f"drives ({after.rmse:.3g} W): do not believe them; something else, or another state of "
        "robot or ground, is behind it. Give both kinds of drives to learn from"
    ]


def change_advice(undated: Residual | None) -> list[str]:
    """Say what the error is where the time of a change is not taken from the judged drive."""
    if undated is None:
        return []
    return [
        "the time of the change was found in the hold-out drive itself, so it is no "
        f"prediction; without it the rmse is {undated.rmse:.3g} W and the energy is off by "
        f"{100 * undated.energy_error:+.1f} %"
    ]


def mass_advice(model: PowerModel, effects: Sequence[str]) -> list[str]:
    """Compare a mass that was found with the vehicle's own."""
    lines = []
    for name in effects:
        if name not in _MASSES:
            continue
        value, error = model.coefficient(name), model.std_error(name) or 0.0
        own = model.vehicle.mass
        # Wheels and gears turn as well: the mass that speeds up is larger than what scales show.
        most = 1.0 if name == "grade" else 1.25
        if value > most * own + max(3 * error, 0.1 * own) or value < 0.9 * own - 3 * error:
            lines.append(
                f"{_plain(name)} gives {value:.0f} +- {error:.0f} kg, the vehicle has "
                f"{own:.0f} kg: weigh it, or check the gain of the power sensor, which is off by "
                "the same factor"
            )
    return lines


def mimic_advice(
    unexplained: Sequence[Dependence], effects: Sequence[str], mimics: Sequence[str] = ()
) -> list[str]:
    """Say that what was found may stand for something the catalogue does not have."""
    if not unexplained:
        return []
    first = next((one for one in unexplained if one.channel != "drive"), None)
    if first is None:
        return []
    if effects:
        names = ", ".join(_plain(name) for name in effects)
        return [
            f"the residual still depends on {first.channel} ({first.shape}): {names} may stand in "
            "for something that the catalogue does not have"
        ]
    lines = [
        f"no effect of the catalogue fits; look at what changes with {first.channel}: {first.shape}"
    ]
    if mimics:
        names = ", ".join(_plain(name) for name in mimics)
        lines.append(
            f"{names} helped only as long as {first.channel} was left out, and was dropped"
        )
    return lines


def map_advice(maps: Sequence[str]) -> list[str]:
    """Say that a map was dropped, which fits the ways of the training drives alone."""
    if not maps:
        return []
    names = ", ".join(_plain(name) for name in maps)
    return [
        f"{names} would fit the training drives, but is probably something else that happened "
        "where they went, and would mislead elsewhere: it was dropped. Drive the same places at "
        "another time, by other ways"
    ]


def vague_advice(vague: Sequence[Effect]) -> list[str]:
    """Say that an effect was dropped of which any size fits about as well."""
    return [
        f"{_plain(effect.name)} was dropped: its error exceeds its size, so that another one, or "
        f"none, fits these drives about as well; to tell it: {effect.manoeuvre}"
        for effect in vague
    ]


def drive_advice(dependences: Sequence[Dependence], significance: float) -> list[str]:
    """Say that drives differ as a whole, where they do, and what no model can then reach."""
    return [
        f"{one.shape}, by more than the scatter within them explains (p = {one.p_value:.1g}): the "
        "ground, the load or a temperature differed, and no channel of the logs recorded it. A "
        "model identified on some drives misses the energy of another one by at "
        f"least {100 * _MEAN_OF_NORMAL * one.values[0]:.1f} % on average: log what differed, or "
        "identify again where the robot drives"
        for one in dependences
        if one.channel == "drive" and one.p_value < significance
    ]


def untested_advice(untested: Sequence[tuple[str, str]], effects: Sequence[str]) -> list[str]:
    """Say which effects could not be tested, and why."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in untested:
        if name not in effects:
            by_reason.setdefault(reason, []).append(_plain(name))
    return [f"not tested, as {reason}: {', '.join(names)}" for reason, names in by_reason.items()]


def few_advice(drives: int) -> list[str]:
    """Say what the intervals of energies assume where too few drives were compared."""
    if drives > 2:
        return []
    return [
        "fewer than three training drives do not show how much runs differ as a whole: intervals "
        f"of energies assume {100 * USUAL_RUN_SPREAD:.0f} %, as of robots elsewhere; record more"
    ]


def log_advice(effects: Sequence[Effect]) -> list[str]:
    """Ask to mend the log where the effect is the log's."""
    return [
        f"{_plain(effect.name)} belongs to the log, not to the robot: mend the sensor or its "
        "driver; a planner must not use it"
        for effect in effects
        if effect.acts == "log"
    ]


def _plain(name: str) -> str:
    return name.replace("_", " ")
