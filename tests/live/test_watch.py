"""A drive as it happens: what is learned, what is told, and that it ends cleanly."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import corridors
import numpy as np
import pytest
import shapely
from commands import Run
from corridors import at
from worlds import tiny

from energyplan import (
    DriveLog,
    Mission,
    PowerModel,
    SurfaceMap,
    evaluate,
    identify,
    simulate,
    watch,
)
from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.fit import fit_residual
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.tables import write_log
from energyplan.live import (
    Changed,
    Done,
    Event,
    Learned,
    Line,
    Reassessed,
    Restart,
    Trouble,
    follow,
    lines_of,
)
from energyplan.live.watcher import Settings
from energyplan.mission import Spreads, Task
from energyplan.output import text
from energyplan.power.effects import with_weight
from energyplan.terrain import Surface

MARBLE = PowerModel.preset("quadriga:full:marble")
CONCRETE = PowerModel.preset("quadriga:full:concrete")
HEADER = "t,v_left,v_right,power"


def told(rows: Iterable[str], *, whole: bool = True, **options: object) -> list[Event]:
    lines = [Line(k, row) for k, row in enumerate(rows, 1)]
    lines[-1] = replace(lines[-1], whole=whole)
    return list(watch(lines, options.pop("prior", MARBLE), **options))  # type: ignore[arg-type]


def only(events: Iterable[Event], kind: type) -> list:
    return [event for event in events if isinstance(event, kind)]


def steady(count: int, start: float = 0.0) -> list[str]:
    return [f"{start + 0.02 * k:.2f},0.5,0.5,80.0" for k in range(count)]


def rows_of(log: DriveLog) -> list[str]:
    names = list(log.channels)
    table = np.column_stack([log.channels[name] for name in names])
    return [",".join(names), *(",".join(map(repr, row)) for row in table.tolist())]


# -- lines ---------------------------------------------------------------------------------------


def steps(*actions: Callable[[], object]) -> Callable[[], bool]:
    """What happens to a file while nothing new is in it; then it is left alone."""
    left = list(actions)

    def wait() -> bool:
        if not left:
            return False
        left.pop(0)()
        return True

    return wait


def add(file: Path, text: str) -> Callable[[], object]:
    def action() -> None:
        with file.open("a") as stream:
            stream.write(text)

    return action


def test_a_growing_file_is_followed_and_half_lines_are_waited_for(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("a,b\n1,")
    lines = follow(file, steps(add(file, "2\n3"), add(file, ",4\n5,")))
    assert list(lines) == [
        Line(1, "a,b"), Line(2, "1,2"), Line(3, "3,4"), Line(4, "5,", whole=False),
    ]  # fmt: skip


def test_a_file_that_was_cut_or_replaced_is_read_anew(tmp_path: Path) -> None:
    file, other = tmp_path / "log.csv", tmp_path / "new.csv"
    file.write_text("a,b\n1,2\n")
    other.write_text("a,b\n7,8\n")
    lines = follow(
        file, steps(lambda: file.write_text("a\n"), lambda: other.replace(file), file.unlink)
    )
    assert list(lines) == [
        Line(1, "a,b"), Line(2, "1,2"), Restart("the file was cut"), Line(1, "a"),
        Restart("another file took its place"), Line(1, "a,b"), Line(2, "7,8"),
    ]  # fmt: skip


def test_a_pipe_ends_with_a_line_that_may_be_cut() -> None:
    assert list(lines_of([b"a,b\r\n", b"1,2"])) == [Line(1, "a,b"), Line(2, "1,2", whole=False)]


def test_lines_without_end_and_files_that_are_not_there_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    with pytest.raises(DriveLogError, match=r"log\.csv cannot be read: No such file"):
        list(follow(file))
    file.write_bytes(b"x" * 200_000)
    with pytest.raises(DriveLogError, match="line 1 is longer than 64 KiB"):
        list(follow(file))


# -- what cannot be used -------------------------------------------------------------------------


def test_what_cannot_be_used_is_told_with_its_place_and_the_rest_is_learned_from() -> None:
    rows = steady(200)
    rows[50] = "1.00,0.5,nan,80.0"
    rows[60] = "1.20,0.5,0.5"
    rows[70] = "1.40,0.5,900,80.0"
    rows[80] = "0.30,0.5,0.5,80.0"
    rows[81] = "1.62,0.5,0.5,"
    rows[199] = "3.98,0.5,0.5,8"
    events = told([HEADER, *rows], whole=False)
    troubles = {trouble.place: trouble.reason for trouble in only(events, Trouble)}
    assert troubles == {
        "line 52": "v_right is no number; set aside",
        "line 62": "cells are missing or too many (there are 4 columns); set aside",
        "line 72": "v_right is beyond -20 to 20 m/s; set aside",
        "line 82": "time does not go forward; set aside",
        "line 83": "power is no number; set aside",
        "line 201": "the line is cut off; set aside",
    }
    assert events[-1].samples == 194
    assert sum(events[-1].set_aside.values()) == 6


def test_a_trouble_that_comes_again_and_again_is_counted() -> None:
    rows = [row if k % 3 else row.replace("80.0", "nan") for k, row in enumerate(steady(300))]
    events = told([HEADER, *rows])
    assert [(t.place, t.count) for t in only(events, Trouble)] == [("line 2", 1), ("line 299", 99)]
    assert events[-1].set_aside == {"power is no number; set aside": 100}


def test_a_clock_that_is_set_back_is_told_and_followed() -> None:
    events = told([HEADER, *steady(100, 50.0), *steady(100)])
    reasons = [trouble.reason for trouble in only(events, Trouble)]
    assert reasons == [
        "time does not go forward; set aside",
        "the clock was set back; it goes on from there",
    ]
    assert events[-1].set_aside == {"the clock was set back; it goes on from there": 1}
    assert events[-1].samples == 200


def test_one_sample_from_the_future_does_not_stop_the_watch() -> None:
    rows = steady(200)
    rows[100] = "1e9,0.5,0.5,80.0"
    events = told([HEADER, *rows])
    assert events[-1].samples == 200
    assert "a gap in time; what was drawn meanwhile is not counted" in events[-1].set_aside


def test_a_file_that_begins_anew_may_bring_its_header_or_not() -> None:
    for again in ([HEADER], []):
        lines = [Line(k, row) for k, row in enumerate([HEADER, *steady(60)], 1)]
        lines = [*lines, Restart("the file was cut"), *map(Line, range(1, 99), again)]
        lines += [Line(k, row) for k, row in enumerate(steady(60, 1.2), 2)]
        events = list(watch(lines, MARBLE))
        assert events[-1].samples == 120
        assert only(events, Trouble)[0].reason.startswith("the file was cut")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["0,0.5,0.5,80"], "no line names the columns"),
        (["t,v_left\0"], "no text in UTF-8"),
        (["t,v_left,power", "0,1,2"], "the channel 'v_right' is missing"),
        (["t,v_left,v_right", "0,1,2"], "power is missing"),
        (["t,t,v_left,v_right,power"], "names the column 't' twice"),
        (["v_left,v_right,power,stamp", "1,1,1,1"], "the channel 't' is missing"),
    ],
)
def test_a_log_of_no_use_is_refused(rows: list[str], message: str) -> None:
    with pytest.raises(DriveLogError, match=message):
        told(rows)


def test_columns_units_and_separators_are_as_in_any_log() -> None:
    plain = told([HEADER, *steady(100)])[-1]
    rows = ["# rover 7", "zeit;links;rechts;u;i;text", "ms;km/h;m/s;V;;", ""]
    rows += [f"{20 * k};1,8;0,5;20,0;-4,0;x" for k in range(100)]
    columns = "t=zeit [ms],v_left=links [km/h],v_right=rechts [m/s],voltage=u [V],current=i[-A]"
    other = told(rows, columns=columns, prior=MARBLE.battery_side())[-1]
    assert other.samples == plain.samples == 100
    assert other.models[0].coefficients[:2] == pytest.approx(plain.models[0].coefficients, rel=1e-2)


def test_the_channels_that_a_model_needs_are_asked_for() -> None:
    with pytest.raises(DriveLogError, match="the model needs slope; map a column"):
        told([HEADER, *steady(30)], prior=with_weight(MARBLE))


# -- learning ------------------------------------------------------------------------------------


def test_it_learns_what_the_online_identifier_learns_and_sees_the_ground_change() -> None:
    log = simulate.drive(MARBLE, "survey", changes=[(30.0, CONCRETE)], power_noise=3.0)
    events = told(rows_of(log))
    online = OnlineIdentifier(MARBLE, period=0.05)
    t = 0.0  # added up as the watcher does: looks for a change are due to the last bit of it
    for k, step in enumerate(np.diff(log.t, prepend=log.t[0] - 0.05).tolist()):
        t += step
        online.update(t, log.channels["v_left"][k], log.channels["v_right"][k], log.power[k])
    assert events[-1].models[0].coefficients == pytest.approx(online.model.coefficients, rel=1e-6)
    [change] = only(events, Changed)
    assert 30.0 < change.t < 40.0
    assert 28.0 < change.onset < 31.0
    found = events[-1].models[0]
    assert np.all(np.abs(found.coefficients - CONCRETE.coefficients) < 4 * np.sqrt(
        np.diag(found.covariance)))  # fmt: skip
    assert [round(one.t) for one in only(events, Learned)] == [10, 20, 30, 40, 50, 60]


def test_the_vehicle_alone_is_enough_to_begin_with() -> None:
    log = simulate.drive(MARBLE, "survey", power_noise=3.0)
    found = told(rows_of(log), prior=MARBLE.vehicle)[-1].models[0]
    assert found.coefficients == pytest.approx(MARBLE.coefficients, rel=0.05)


def test_nothing_to_begin_with_and_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="give a model, a vehicle or a mission"):
        told([HEADER], prior=None)
    with pytest.raises(InvalidInputError, match="every is 0; give a positive number"):
        Settings(every=0)
    with pytest.raises(InvalidInputError, match="soc is 80; give a fraction"):
        Settings(soc=80)
    assert told([HEADER])[-1].samples == 0
    assert told([HEADER, "0,0.5,0.5,80"])[-1].samples == 1


# -- the mission ---------------------------------------------------------------------------------

CAPACITY = 40e3


def corridor(**changes: object) -> Mission:
    tasks = at("near", 8.0, dwell=2.0), at("far", 20.0)
    values = {"model": MARBLE, "spreads": Spreads(), **changes}
    return corridors.corridor(CAPACITY, tasks, 3.0, **values)


def along(power: float, soc: str = "") -> list[str]:
    """10 s at 0.5 m/s from x = 3 to 8 m, then 5 s of standing there."""
    rows = ["t,v_left,v_right,power,x,y,yaw" + (",soc" if soc else "")]
    for k in range(301):
        t, v = 0.05 * k, 0.5 if k < 200 else 0.0
        x = 3.0 + 0.5 * min(t, 10.0)
        rows.append(f"{t:.2f},{v},{v},{power if v else 0.0},{x:.4f},1.5,0.0" + soc)
    return rows


def test_the_rest_of_the_mission_is_evaluated_from_where_the_robot_is() -> None:
    """An ideal battery: the charge falls by the energy that was drawn."""
    mission = corridor()
    events = told(along(100.0), prior=None, mission=mission)
    [done] = only(events, Done)
    assert (done.task, done.t) == ("near", pytest.approx(12.0, abs=0.11))
    looks = only(events, Reassessed)
    assert [look.done for look in looks] == [(), ("near",), ("near",)]
    last = looks[-1]
    assert last.pose == pytest.approx((8.0, 1.5, 0.0))
    lost = MARBLE.battery_side().vehicle.drive_efficiency
    assert lost == 1.0  # so that what the motors draw is what the battery gives
    assert 1.0 - last.soc == pytest.approx(100.0 * 10.0 / CAPACITY, rel=1e-3)
    learned = only(events, Learned)[-1].model
    by_hand = mission.resume((8.0, 1.5, 0.0), last.soc, ["near"], time=15.05, model=learned)
    assert last.report is not None
    assert last.report.energy == pytest.approx(evaluate(by_hand).energy, rel=1e-3)


@pytest.mark.parametrize(
    ("ends", "direction", "is_done"),
    [((4.0, 7.5), "given", True), ((7.5, 4.0), "either", True), ((7.5, 4.0), "given", False),
     ((4.0, 10.0), "given", False)],
)  # fmt: skip
def test_a_row_is_done_at_its_end_and_the_rest_takes_what_is_left_of_the_mission(
    ends: tuple[float, float], direction: str, is_done: bool
) -> None:
    """Its charge is what was drawn; one that is driven in part or the wrong way is still to do."""
    line = Task(
        "row", path=[(x, 1.5) for x in ends], direction=direction,  # type: ignore[arg-type]
        power=40.0,
    )  # fmt: skip
    mission = replace(corridor(), tasks=(line, at("far", 12.0)), return_to="start")
    settings = Settings()
    events = told(along(100.0), prior=None, mission=mission, settings=settings)
    done = only(events, Done)
    assert [one.task for one in done] == (["row"] if is_done else [])
    if is_done:
        assert (7.5 - settings.near - 3.0) / 0.5 <= done[0].t <= 4.5 / 0.5 + 0.1
    last = only(events, Reassessed)[-1]
    assert last.done == (("row",) if is_done else ())
    assert 1.0 - last.soc == pytest.approx(100.0 * 10.0 / CAPACITY, rel=1e-3)
    learned = only(events, Learned)[-1].model
    rows = {"row": [(8.0, 1.5, 0.0), (ends[1], 1.5, 0.0)]} if ends[1] == 10.0 else {}
    rest = mission.resume(
        (8.0, 1.5, 0.0), last.soc, last.done, time=15.05, model=learned, rows=rows
    )
    assert last.report is not None
    assert last.report.energy == pytest.approx(evaluate(rest).energy, rel=5e-3 if rows else 1e-3)
    assert last.driven == ({"row": pytest.approx(4.0, abs=0.03)} if rows else {})


def test_a_measured_charge_is_believed_and_one_that_cannot_be_is_told() -> None:
    events = told(along(100.0, ",0.6"), prior=None, mission=corridor())
    assert [look.soc for look in only(events, Reassessed)] == pytest.approx([0.6, 0.6, 0.6])
    events = told(along(100.0, ",60"), prior=None, mission=corridor())
    assert any("soc is no fraction" in trouble.reason for trouble in only(events, Trouble))


def test_a_harder_ground_takes_the_mission_out_of_reach() -> None:
    """As expected 22 m of way and 5 m back take what there is; drawn was three times as much."""
    straight = float(2 * MARBLE.coefficients[1])
    mission = corridor(battery=tiny(1.2 * straight * 34))
    assert evaluate(mission).feasible
    events = told(along(1.8 * straight * 0.5), prior=None, mission=mission)
    report = only(events, Reassessed)[-1].report
    assert report is not None
    assert not report.feasible
    assert report.task("far").reason == "battery"


def test_a_mission_that_is_done_or_cannot_be_looked_at_is_told() -> None:
    done = Settings(done=("far",))
    last = only(told(along(100.0), prior=None, mission=corridor(), settings=done), Reassessed)[-1]
    assert last.report is None
    empty = Settings(soc=0.0)
    events = told(along(100.0), prior=None, mission=corridor(), settings=empty)
    assert any("charge first" in trouble.reason for trouble in only(events, Trouble))
    with pytest.raises(InvalidInputError, match="the mission has no task nowhere"):
        told(along(1.0), prior=None, mission=corridor(), settings=Settings(done=("nowhere",)))


def test_a_border_that_the_map_knows_is_no_change_of_ground() -> None:
    """Two grounds that differ much; each learns its own."""
    log = simulate.drive(MARBLE, "survey", changes=[(30.0, CONCRETE)], power_noise=3.0)
    x = np.where(log.t < 30.0, 3.0, 20.0)
    others = {"x": x, "y": np.full(len(x), 1.5), "yaw": np.zeros(len(x))}
    log = DriveLog({**log.channels, **others})
    surfaces = SurfaceMap([Surface(shapely.box(10, 0, 35, 3), CONCRETE)])
    events = told(rows_of(log), prior=None, mission=corridor(surfaces=surfaces))
    assert only(events, Changed) == []
    for found, truth in zip(events[-1].models, (MARBLE, CONCRETE), strict=True):
        assert found.coefficients == pytest.approx(truth.coefficients, rel=0.05)


@pytest.mark.parametrize("points", ["line", "corner", "poses"])
def test_what_is_left_of_a_row_counts_from_where_the_robot_is(points: str) -> None:
    """The robot stands at x = 8 m, 5 m into the row, and a little beside it."""
    ends = {"line": [(3.0, 1.5), (20.0, 1.5)], "corner": [(3.0, 1.5), (12.0, 1.5), (12.0, 2.0)],
            "poses": [(3.0, 1.5, 0.0), (20.0, 1.5, 0.0)]}[points]  # fmt: skip
    row = Task("row", path=ends, power=40.0, payload_per_metre=-0.2)
    mission = replace(corridor(payload=5.0), tasks=(row,), return_to="start")
    beside = [one.replace(",1.5,0.0", ",1.52,0.0") for one in along(100.0)]
    events = told(beside, prior=None, mission=mission)
    assert only(events, Done) == []
    assert not [one for one in only(events, Trouble) if "looked at" in one.reason]
    last = only(events, Reassessed)[-1]
    assert last.driven == {"row": pytest.approx(5.0, abs=0.03)}
    assert last.pose == pytest.approx((8.0, 1.52, 0.0))
    rest = replace(row, path=[(8.0, 1.5), *ends[1:]] if points != "poses" else
                   [(8.0, 1.5, 0.0), ends[1]], direction="given")  # fmt: skip
    alone = replace(mission, start=(8.0, 1.5, 0.0), home=mission.start, soc=last.soc,
                    payload=4.0, tasks=(rest,))  # fmt: skip
    assert last.report.energy == pytest.approx(evaluate(alone).energy, rel=5e-3)
    whole = mission.resume((8.0, 1.5, 0.0), last.soc)
    assert last.report.energy < 0.9 * evaluate(whole).energy
    assert "row driven for 5.0 m" in text.event(last)[0]


def test_a_mission_with_payload_keeps_its_models() -> None:
    mission = corridor(payload=5.0)
    events = told(along(300.0), prior=None, mission=mission)
    assert any("moves payload" in trouble.reason for trouble in only(events, Trouble))
    last = only(events, Reassessed)[-1]
    same = evaluate(mission.resume((8.0, 1.5, 0.0), last.soc, ["near"]))
    assert last.report.energy == pytest.approx(same.energy, rel=1e-6)


# -- the command ---------------------------------------------------------------------------------

COMMAND = [sys.executable, "-m", "energyplan"]


def test_the_command_prints_a_json_line_for_each_event_and_keeps_the_model(tmp_path: Path) -> None:
    log = simulate.drive(MARBLE, "survey", power_noise=3.0)
    file = write_log(log, tmp_path / "log.csv")
    model = tmp_path / "model.yaml"
    done = subprocess.run(
        [*COMMAND, "watch", "-", "--vehicle", "quadriga:full", "--json", "--out", str(model)],
        input=file.read_text() + "1.0,2", capture_output=True, text=True, check=True,
    )  # fmt: skip
    events = [json.loads(line) for line in done.stdout.splitlines()]
    kinds = [event["event"] for event in events]
    assert kinds[-3:] == ["trouble", "learned", "ended"]
    assert "the line is cut off; set aside" in events[-1]["set_aside"]
    values = [term["value"] for term in events[-1]["models"][0]["terms"]]
    assert read_model(model).coefficients == pytest.approx(values)


def test_the_command_ends_well_with_ctrl_c_and_with_a_closed_pipe(tmp_path: Path) -> None:
    """The writer never ends its pipe; the watch has told something before it is stopped."""
    rows = "\n".join([HEADER, *steady(2000)]) + "\n"
    for stop in ("interrupt", "close"):
        with subprocess.Popen(
            [*COMMAND, "watch", "-", "--vehicle", "quadriga:full"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            assert process.stdin and process.stdout and process.stderr
            process.stdin.write(rows)
            process.stdin.flush()
            assert process.stdout.readline().startswith("10.0 s: mu = ")
            if stop == "interrupt":
                os.kill(process.pid, signal.SIGINT)
                assert "the end: " in process.stdout.read()
            else:
                process.stdout.close()
                with suppress(BrokenPipeError):  # it may end before all is written
                    process.stdin.write("\n".join(steady(4000, 40.0)) + "\n")
                    process.stdin.close()
            assert process.stderr.read() == ""
            assert process.wait() == 0


def test_the_icr_of_a_spin_by_its_angle(tmp_path: Path, run: Run) -> None:
    """Eq. 5: half the difference of the treads' ways over the angle."""
    t = np.arange(0.0, 20.0, 0.05)
    speed = np.full(len(t), 0.3)
    log = DriveLog({"t": t, "v_left": -speed, "v_right": speed, "power": 0 * t})
    file = write_log(log, tmp_path / "spin.csv")
    out = tmp_path / "vehicle.yaml"
    found = run("identify", file, "--vehicle", "quadriga", "--spin", "--angle", "720deg",
                "--out", out, "--json").json  # fmt: skip
    expected = 0.3 * t[-1] / (4 * np.pi)
    assert found["icr"]["left"] == pytest.approx(expected)
    assert read_vehicle(str(out)).icr.left == pytest.approx(expected)


# -- runs that differ as a whole ----------------------------------------------------------------


def runs_of(count: int, keeps: bool) -> list[DriveLog]:
    """Runs that take more or less than others, throughout or in their first quarter alone."""
    logs = []
    for k in range(count):
        factor = np.exp(0.3 * np.random.default_rng(k).standard_normal())
        log = simulate.drive(MARBLE, "survey", power_noise=5.0, seed=k)
        early = log.t - log.t[0] <= 0.25 * log.duration
        power = log.power * np.where(early | keeps, factor, 1.0)
        logs.append(DriveLog({"t": log.t, "power": power,
                              **{n: log.channel(n) for n in ("v_left", "v_right", "yaw_rate")}},
                             f"run {k}"))  # fmt: skip
    return logs


@pytest.mark.parametrize("keeps", [True, False])
def test_the_rest_of_a_run_keeps_as_much_of_its_factor_as_former_runs_did(keeps: bool) -> None:
    *former, run = runs_of(7, keeps)
    prior = identify(former, MARBLE.vehicle).model
    first = run.segment(float(run.t[0]), float(run.t[0]) + 0.25 * run.duration)
    rest = run.segment(float(run.t[0]) + 0.25 * run.duration, float(run.t[-1]))
    rows = [HEADER] + [
        ",".join(str(value) for value in row)
        for row in zip(first.t, *(first.channel(n) for n in HEADER.split(",")[1:-1]), first.power,
                       strict=True)
    ]  # fmt: skip
    learned = only(told(rows, prior=prior, former=former), Learned)[-1]
    before, after = (
        abs(fit_residual(model, rest).energy_error) for model in (prior, learned.model)
    )
    if keeps:
        assert before > 0.1
        assert after < 0.3 * before
    else:
        assert after < before + 0.03


def test_former_runs_need_the_model_that_was_identified_from_them() -> None:
    with pytest.raises(InvalidInputError, match="former runs"):
        told([HEADER], prior=MARBLE.vehicle, former=runs_of(1, True))
