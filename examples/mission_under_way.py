"""Ask again in mid-mission: the ground turned out dearer than the model said.

Run ``python examples/mission_under_way.py``.
"""

from __future__ import annotations

from pathlib import Path

from energyplan import evaluate, read_mission
from energyplan.mission import MissionReport


def tell(title: str, report: MissionReport) -> None:
    """Print what can be done."""
    print(
        f"{title}: {report.headline}; "
        f"ends at {100 * report.soc_end:.0f} % (at least {100 * report.soc_end_lower:.0f} %)"
    )
    for task in report.tasks:
        print(f"  {task.name:24s} {task.verdict:12s} {task.reason:20s} {task.remedy}")


def main() -> None:
    """Evaluate the mission, then the rest of it after two tasks."""
    mission = read_mission(Path(__file__).with_name("mission_warehouse.yaml"))
    before = evaluate(mission)
    tell("before leaving", before)

    # Two tasks later the battery is lower than expected, and the model that was corrected on the
    # way draws a fifth more. OnlineIdentifier.model gives such a model.
    learned = mission.model.with_coefficients(1.2 * mission.model.coefficients)
    rest = mission.resume(
        pose=mission.tasks[1].pose,
        soc=before.task("inspect the gate").soc_after - 0.25,
        done=["scrub the west aisle", "inspect the gate"],
        time=2100.0,
        model=learned,
    )
    tell("under way", evaluate(rest))


if __name__ == "__main__":
    main()
