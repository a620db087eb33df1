"""The commands that learn from drives: start, identify, diagnose, watch."""

from __future__ import annotations

import json as jsonlib
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from math import nan
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from energyplan.cli import options as opt
from energyplan.cli.answers import (
    answer,
    following,
    give_up_stdout,
    progress,
    say,
    verdict,
    warn,
    warn_with_answer,
    write_report,
)
from energyplan.cli.app import app
from energyplan.cli.options import RobotOptions, number
from energyplan.errors import EnergyPlanError, InvalidInputError, NotIdentifiableError

if TYPE_CHECKING:
    from energyplan.fit import ICREstimate
    from energyplan.io.start import Start
    from energyplan.live import Line, Restart
    from energyplan.logs import DriveLog
    from energyplan.power import Term

_POLL = 0.2  # time between two looks at a file that does not grow [s]
_QUESTIONS = {
    "track": "Distance of the left from the right wheels' contact points [m]",
    "wheelbase": "Distance of the front from the rear wheels' contact points [m]",
    "mass": "Mass as it drives [kg]",
    "wheel_radius": "Radius of the wheels [m], where their rates are logged",
}


@dataclass(frozen=True)
class MeasureOptions:
    """What is known of a robot that no vehicle describes."""

    wheel_radius: Annotated[float | None, Option(help="Radius of the wheels [m].")] = None
    track: Annotated[
        float | None, Option(help="Distance of left from right contact points [m].")
    ] = None
    wheelbase: Annotated[
        float | None, Option(help="Distance of front from rear contact points [m].")
    ] = None
    mass: Annotated[float | None, Option(help="Mass as it drives, with payload [kg].")] = None
    counts_per_revolution: Annotated[
        float | None, Option(metavar="N", help="Counts of an encoder for one turn of the wheel.")
    ] = None

    @property
    def known(self) -> dict[str, float]:
        """What is given."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@app.command(
    epilog="Example: energyplan start foreign.csv --track 0.5 --wheelbase 0.475 --mass 147 "
    "--out robot.yaml"
)
def start(
    logs: opt.Logs,
    *,
    out: Annotated[
        Path | None, opt.output("Write the project to this YAML file.", *opt.YAML)
    ] = None,
    measures: MeasureOptions,
    name: Annotated[str, Option(help="Name of the robot. Default: the project's.")] = "",
    like: Annotated[
        str | None,
        Option(
            metavar="VEHICLE",
            help="Start from this vehicle, or from a URDF, Clearpath's robot.yaml or parameters of "
            "diff_drive_controller; other options override it.",
        ),
    ] = None,
    columns: opt.Columns = None,
    unsigned: opt.Unsigned = False,
    reverse: Annotated[
        Literal["yes", "no"] | None,
        Option(help="Whether plans may drive this robot backwards. Default: yes, with a note."),
    ] = None,
    accept: Annotated[
        bool, Option("--accept", help="Accept a log with a check that is WRONG.")
    ] = False,
    resolution: Annotated[
        float | None, Option(help="Size of a pixel, of the image of a map in place of a log [m].")
    ] = None,
    plot: Annotated[
        Path | None, opt.output("Draw the map of an image: .png, .svg or .pdf.", *opt.IMAGES)
    ] = None,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Write a project from drive logs of one robot, or the YAML of the image of a map.

    Guesses columns, topics and units, and checks the log against the robot. What it cannot know it
    takes from the options, or asks for on a terminal. A log that contradicts itself or the robot
    makes no project, unless you accept that. Other commands read the project with --project.
    """
    from energyplan.io.maps import IMAGES

    if len(logs) == 1 and logs[0].suffix.lower() in IMAGES:
        _start_map(logs[0], resolution, out, plot, json=json)
        return
    for option, value in (("--resolution", resolution), ("--plot", plot)):
        if value is not None:
            raise InvalidInputError(f"{option} is for the image of a map; leave it out with logs")

    from energyplan.io.given import Given, read_like
    from energyplan.io.start import start_all
    from energyplan.output import documents, text

    typed: dict[str, float] = {}
    if like is None and not json and sys.stdin.isatty() and sys.stderr.isatty():
        replies = {key: _ask(_QUESTIONS[key]) for key in _QUESTIONS if key not in measures.known}
        typed = {key: value for key, value in replies.items() if value is not None}
    known: Any = ({} if like is None else read_like(like)) | measures.known | typed
    if not name and like is None and out is not None:
        name = out.stem  # a robot is called as its project is, not as a drive of it
    given = Given(**known, name=name, columns=opt.columns_of(columns), unsigned=unsigned)
    try:
        with progress("looking into the log"):
            result = start_all(logs, given)
    except EnergyPlanError:
        if typed:  # so that nobody need type it again
            warn("typed: " + " ".join(f"--{k.replace('_', '-')} {v:g}" for k, v in typed.items()))
        raise
    result = _with_reverse(result, reverse, like)
    sound = result.sound or accept
    done = _write_start(result, logs, out) if sound else (
        f"not written: {'a project' if out is None else out}; mend what is WRONG, or write it all "
        "the same with --accept"
    )  # fmt: skip
    answer(documents.start(result), [*text.start(result), done], json=json)
    verdict(result.sound, strict or not sound)


def _with_reverse(result: Start, reverse: str | None, like: str | None) -> Start:
    """Set whether the robot may drive backwards; where nothing says so, a note does."""
    if reverse is not None:
        robot = replace(result.project.vehicle, reverse=reverse == "yes")
        result = replace(result, project=replace(result.project, vehicle=robot))
    elif like is None:
        note = "plans may drive the robot backwards; give --reverse no where it must not"
        result = replace(result, notes=(*result.notes, note))
    return result


def _write_start(result: Start, logs: list[Path], out: Path | None) -> str:
    """Write a project, where it is to be written; return what is to be done next."""
    from energyplan.io.config import write_project

    if out is None:
        return "give --out PROJECT.yaml to write it as a project"
    write_project(result.project, out)
    then = following("diagnose", *logs, "--project", out, "--out", "model.yaml", keep="")
    return f"written: {out}; next: {then}"


def _start_map(
    image: Path, resolution: float | None, out: Path | None, plot: Path | None, *, json: bool
) -> None:
    """Read the image of a map, say what is in it, and write its YAML."""
    from energyplan.io.files import atomic_write
    from energyplan.io.maps import read_map, write_map_of_image
    from energyplan.output import documents, text

    if resolution is None and out is not None:
        raise InvalidInputError("give --resolution, the size of a pixel of the image in m")
    if resolution is None or out is None:
        grid = read_map(image, resolution=resolution)
        done = "give --out MAP.yaml to write its YAML"
    else:
        grid = write_map_of_image(image, resolution, out)
        words = ("--map", out, "--model", "MODEL", "--start", "X,Y,YAW", "--goal", "X,Y,YAW")
        done = f"written: {out}; next: {following('compare', *words, keep='')}"
    if plot is not None:
        from energyplan.output import plots

        atomic_write(plot, plots.image(plots.routes(grid, {}), plot.suffix))
    answer(documents.occupancy(grid), [*text.occupancy(grid), done], json=json)


def _ask(question: str) -> float | None:
    """Ask for a number on the terminal; an empty answer leaves it to the log."""
    text = typer.prompt(f"{question}, empty for a guess", default="", show_default=False, err=True)
    try:
        return float(text) if text.strip() else None
    except ValueError:
        raise InvalidInputError(f"{text!r} is no number; write it like 0.555") from None


@dataclass(frozen=True)
class KindOptions:
    """What the logs hold, where it is no drive."""

    hoisted: Annotated[
        bool,
        Option("--hoisted", help="Wheels off the ground: find their friction."),
    ] = False
    motor_constant: Annotated[
        float | None,
        Option(metavar="K", help="With --hoisted: force per ampere of a side's motor [N/A]."),
    ] = None
    spin: Annotated[
        bool,
        Option(
            "--spin",
            help="The log holds one spin on the spot: find the tread ICRs alone (Morales et al. "
            "2010, Eq. 5). --out then writes the vehicle with them.",
        ),
    ] = False
    angle: Annotated[str | None, Option(help="With --spin: angle turned, as 3600deg.")] = None
    angle_error: Annotated[str, Option(help="With --angle: its standard error.")] = "0deg"
    battery: Annotated[
        str | None,
        Option(metavar="BATTERY", help="Of a history of tasks that tells shares of its charge."),
    ] = None

    def check(self, logs: list[Path], terms: str | None, out: Path | None) -> None:
        """Refuse options that do not go together."""
        for name, given, mode, chosen in (
            ("--motor-constant", self.motor_constant, "--hoisted", self.hoisted),
            ("--angle", self.angle, "--spin", self.spin),
        ):
            if given is not None and not chosen:
                raise InvalidInputError(f"{name} goes with {mode}; give both or neither")
        if self.spin and (self.hoisted or terms):
            raise InvalidInputError("--spin finds the tread ICRs alone; leave other options out")
        if self.spin and len(logs) > 1:
            raise InvalidInputError("--spin takes one log; cut the spin out, or leave --spin out")
        if self.hoisted and (out or terms):
            raise InvalidInputError("--hoisted makes no model; leave out --out and the terms")


@app.command(
    epilog="Example: energyplan identify spiral.csv --vehicle quadriga:full --out model.yaml"
)
def identify(
    logs: opt.Logs,
    *,
    robot: RobotOptions,
    method: Annotated[
        Literal["lad", "simplex", "huber", "windows"],
        Option(
            help="lad: least absolute deviations; simplex: the same by the paper's search; huber: "
            "robust least squares; windows: as diagnose fits."
        ),
    ] = "lad",
    terms: Annotated[
        str | None,
        Option(
            metavar="NAME,NAME",
            help="Terms of the model. Default: slip_friction,traction_resistance.",
        ),
    ] = None,
    kind: KindOptions,
    out: opt.OutModel = None,
    json: opt.Json = False,
) -> None:
    """Find a robot's power parameters from drive logs, or from a history of tasks.

    A history is a table with a row a task: distance, turning, duration, and energy or charge.
    The method lad minimises the cost of Morales et al. (2010), "the paper", Eq. 7, exactly; simplex
    does so by the paper's search.
    """
    from energyplan.fit import identify as run
    from energyplan.fit.tasks import identify_tasks
    from energyplan.io.config import read_vehicle, write_model, write_vehicle
    from energyplan.io.logs import tasks_of
    from energyplan.output import documents, text

    vehicle = read_vehicle(robot.vehicle)
    kind.check(logs, terms, out)
    table = None
    if len(logs) == 1 and not (kind.spin or kind.hoisted or terms or robot.columns):
        table = _table(logs[0])
        history = None if table is None else tasks_of(table, _full(kind.battery))
        if history is not None:
            learned = identify_tasks(history, vehicle)
            if out:
                write_model(learned.model, out)
            answer(documents.tasks(learned, history), text.tasks(learned, history), json=json)
            return
    if kind.battery is not None:
        raise InvalidInputError("--battery goes with a history of tasks; leave it out")
    drives = _read(logs, robot, table)
    if kind.spin:
        icr = _icr_of_spin(drives[0], kind.angle, kind.angle_error)
        if out:
            write_vehicle(vehicle.with_icr(icr.icr), out)
        answer(documents.icr(icr), text.icr(icr), json=json)
    elif kind.hoisted:
        _answer_hoisted(drives, kind.motor_constant, json=json)
    else:
        found = run(drives, vehicle, terms=_terms(terms), method=method)
        doubts = (*_notes(drives, found.warnings), *_contradictions(drives, vehicle))
        found = replace(found, warnings=(*doubts, *found.warnings))
        if out:
            write_model(found.model, out)
        then = following("diagnose", *logs, "--out", "diagnosed.yaml", keep=opt.OF_ROBOT)
        answer(documents.identification(found), found, json=json, then=then)


def _answer_hoisted(drives: list[DriveLog], motor_constant: float | None, *, json: bool) -> None:
    """Find the friction of wheels off the ground, and say what it is."""
    from energyplan.fit.identification import doubts_off_the_ground, hoisted
    from energyplan.output import documents, text

    sides = hoisted(drives, motor_constant)
    notes = _notes([replace(log, warnings=doubts_off_the_ground(log)) for log in drives])
    if motor_constant is None:
        notes += [
            f"{side.side}: the power hardly grows with speed, as if it were voltage times "
            "motor current; then give --motor-constant, such as 21.4 for a Husky"
            for side in sides
            if side.power_without_speed
        ]
    lines = [*text.hoisted(sides), *(f"note: {line}" for line in notes)]
    answer({"sides": documents.plain(sides), "warnings": notes}, lines, json=json)


def _table(path: Path) -> Any:
    """Return what a table holds, which may be a history of tasks, or a drive."""
    from energyplan.io.logs import has_messages, read_recording

    return None if has_messages(path) else read_recording(path)


def _full(battery: str | None) -> float:
    """Return what a battery holds [J]; NaN where none is given."""
    if battery is None:
        return nan
    from energyplan.io.mission import read_battery

    return read_battery(battery).full_energy


def _read(paths: list[Path], robot: RobotOptions, first: Any = None) -> list[DriveLog]:
    from energyplan.io.logs import read_drives

    with progress("reading") as update:
        read = read_drives(paths, robot.vehicle, robot.columns, robot.topics, update, first)
    return [replace(log, signed=False) for log in read] if robot.unsigned else read


def _contradictions(logs: list[DriveLog], vehicle: Any) -> list[str]:
    from energyplan.logs.consistency import contradictions

    return [f"{log.name}: {check}" for log in logs for check in contradictions(log, vehicle)]


def _notes(logs: list[DriveLog], known: Sequence[str] = ()) -> list[str]:
    """Return warnings from reading logs that are not yet shown; each once for several logs."""
    from energyplan.html import listed

    warned: dict[str, list[str]] = {}
    for log in logs:
        for warning in (one for one in log.warnings if not any(one in text for text in known)):
            warned.setdefault(warning, []).append(log.name)
    return [f"{listed(names)}: {warning}" for warning, names in warned.items()]


def _icr_of_spin(drive: DriveLog, angle: str | None, angle_error: str) -> ICREstimate:
    """Return the tread ICRs from one spin; warn of an angle that the log contradicts."""
    from energyplan.fit import icr_from_spin

    rotation = None if angle is None else number("--angle", "angle", angle)
    found = icr_from_spin(drive, rotation, number("--angle-error", "angle", angle_error))
    with suppress(NotIdentifiableError):  # the log need not show the angle
        shown = icr_from_spin(drive).turning
        if abs(shown - found.turning) > 0.1 * found.turning:
            warn(
                f"--angle {angle} is {found.turning:.4g} rad, but by its yaw the log turns "
                f"through {shown:.4g} rad in all, to either side; which is right?"
            )
    return found


def _terms(names: str | None) -> list[Term]:
    """Return the terms that a model is to have."""
    from energyplan.power import SLIP, TRACTION
    from energyplan.power.effects import term

    wanted = [name.strip() for name in (names or "").split(",") if name.strip()]
    return list(map(term, dict.fromkeys(wanted))) or [SLIP, TRACTION]


@app.command(
    epilog="Example: energyplan diagnose a.csv b.csv --holdout c.csv --vehicle quadriga "
    "--out extended.yaml --report diagnosis.html"
)
def diagnose(
    logs: opt.Logs,
    robot: RobotOptions,
    holdout: Annotated[
        list[Path] | None,
        Option(
            metavar="LOG...",
            help="Drives kept for validation. Default: the last 40 % of each drive; of drives "
            "under 40 s some as a whole.",
        ),
    ] = None,
    border: Annotated[
        bool,
        Option("--border", help="Also look for another surface beyond a line on the ground."),
    ] = False,
    change: Annotated[
        bool,
        Option("--change", help="Also look for a payload or a surface that changed at some time."),
    ] = False,
    out: opt.OutModel = None,
    report: opt.Report = None,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Find out why the model and the logs differ.

    Traces the residual of the power model to effects, adds them to the model, and reports the error
    before and after on hold-out drives.
    """
    from energyplan.diagnosis import diagnose as run
    from energyplan.fit import split_drives
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.io.files import same_file
    from energyplan.logs.clean import set_aside_by_drive
    from energyplan.output import documents
    from energyplan.output.pages import diagnosis_page

    vehicle = read_vehicle(robot.vehicle)
    for path in logs:
        if any(same_file(path, other) for other in holdout or []):
            raise InvalidInputError(
                f"{path.name} is both a training and a hold-out drive; leave it in one list"
            )
    training = _read(logs, robot)
    judging = _read(holdout, robot) if holdout else []
    read = [*training, *judging]
    for note in (*_notes(read), *_contradictions(read, vehicle)):
        warn(note)
    if not judging:
        training, judging = split_drives(training)
    parts = {
        "training": [drive.name for drive in training],
        "judging": [drive.name for drive in judging],
    }
    with progress("diagnosing") as update:
        result = run(
            training, holdout=judging, vehicle=vehicle, border=border, change=change,
            progress=update,
        )  # fmt: skip
    result = replace(result, set_aside=set_aside_by_drive(read))
    lines = [f"{part}: {', '.join(names)}" for part, names in parts.items()]
    if out:
        write_model(result.model, out)
    if report:
        page = diagnosis_page(result, judging)
        page.heading("Drives")
        page.bullets(lines)
        write_report(page, report)
    ends = ("--start", "X,Y,YAW", "--goal", "X,Y,YAW")
    then = following("compare", "--map", "MAP.yaml", "--model", out, *ends, keep="") if out else ""
    answer({**parts, **documents.diagnosis(result)}, [*lines, result], json=json, then=then)
    verdict(result.verdict != "unexplained", strict)


@app.command(
    epilog="Example: energyplan watch drive.csv --vehicle husky_a200 --once --out model.yaml"
)
def watch(
    log: Annotated[str, Argument(help="A CSV log that grows, or - for standard input.")],
    model: Annotated[str | None, Option(metavar="MODEL", help="Model to begin with.")] = None,
    vehicle: Annotated[str | None, Option(metavar="VEHICLE", help="In place of a model.")] = None,
    mission: Annotated[Path | None, Option(help="YAML file of the robot's mission.")] = None,
    robot: Annotated[
        str | None,
        Option(metavar="NAME", help="Whose log it is, of a mission of several robots."),
    ] = None,
    columns: opt.Columns = None,
    once: Annotated[bool, Option("--once", help="Stop at the end of the file.")] = False,
    every: Annotated[float, Option(help="Time between two reports [s].")] = 10.0,
    former: Annotated[
        list[Path] | None,
        Option(
            metavar="LOG...",
            help="Runs that --model was identified from, three or more: this run then has a factor "
            "of its own, as much of it as former runs kept.",
        ),
    ] = None,
    out: opt.OutModel = None,
    json: opt.Json = False,
) -> None:
    """Follow a drive while it happens.

    Learns the robot's model, says when the ground changes, and evaluates the rest of the mission.
    One line for each event; with --json each is a JSON document. Ctrl-C ends it.
    """
    from energyplan.io.config import read_model, read_vehicle, write_model
    from energyplan.io.logs import read_drives
    from energyplan.io.mission import read_mission
    from energyplan.live import Learned, follow, lines_of
    from energyplan.live import watch as events
    from energyplan.live.watcher import Settings
    from energyplan.mission import evaluate
    from energyplan.output import documents, text

    if model and vehicle:
        raise InvalidInputError("--model and --vehicle: a model has its vehicle; give one of them")
    if not (model or vehicle or mission):
        raise InvalidInputError("the robot is not known; give --model, --vehicle or --mission")
    if former and not model:
        raise InvalidInputError("--former goes with the --model that was identified from it")
    prior = read_model(model) if model else read_vehicle(vehicle) if vehicle else None
    wanted = read_mission(mission) if mission else None
    if robot is not None:
        if wanted is None or not wanted.robots:
            raise InvalidInputError("--robot goes with a --mission of several robots; leave it out")
        with progress("sharing the tasks"):
            wanted = evaluate(wanted).share(robot)
    source = lines_of(sys.stdin.buffer) if log == "-" else follow(log, None if once else _wait)
    learned: Any = None
    known = read_drives(former, str(model), columns) if former else []
    try:
        with _until_interrupted(source) as lines:
            found = events(
                lines, prior, wanted, columns=opt.columns_of(columns), name=log,
                settings=Settings(every), former=known,
            )  # fmt: skip
            for k, event in enumerate(found):
                if k == 0:
                    warn_with_answer()
                if isinstance(event, Learned):
                    learned = event.model
                    if out:
                        write_model(learned, out)
                line = jsonlib.dumps(documents.event(event), allow_nan=False) if json else ""
                say(line or "\n".join(text.event(event)))
                sys.stdout.flush()
    except BrokenPipeError:
        give_up_stdout()  # whoever read has seen enough
    if out and learned is None:
        warn(f"nothing was learned: {out} is not written")


def _wait() -> bool:
    time.sleep(_POLL)
    return True


@contextmanager
def _until_interrupted(
    lines: Iterable[Line | Restart],
) -> Iterator[Iterator[Line | Restart]]:
    """Let Ctrl-C end the lines, so that what follows from them is still printed."""
    stopped = waiting = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        if waiting:
            raise KeyboardInterrupt

    def wanted() -> Iterator[Line | Restart]:
        nonlocal waiting
        source = iter(lines)
        while not stopped:
            waiting = True
            with suppress(KeyboardInterrupt):
                line = next(source, None)
            waiting = False
            if stopped or line is None:
                return
            yield line

    try:
        before = signal.signal(signal.SIGINT, stop)
    except ValueError:  # not the main thread, which alone gets signals
        yield wanted()
        return
    try:
        yield wanted()
    finally:
        signal.signal(signal.SIGINT, before)
