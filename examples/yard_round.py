"""Does the battery last for a round of 2 km? On the shortest routes it does not.

    python examples/yard_round.py

The mission is evaluated with routes of least energy, with the shortest ones (from a full battery,
to see what they take), and with a remedy that the first answer proposes for the task out of reach.
"""

from __future__ import annotations

from dataclasses import replace

import energyplan as ep
from energyplan.io.files import bundled
from energyplan.mission import MissionReport, Routes


def tell(title: str, report: MissionReport) -> None:
    """Print what comes of a mission."""
    length = sum(path.length for path in report.paths)
    print(
        f"{title}: {report.sentence}; {length / 1000:.2f} km, {report.energy / 3600:.1f} Wh, "
        f"at most {report.energy_upper / 3600:.1f} Wh"
    )
    for task in report.tasks:
        if task.verdict == "unreachable":
            print(f"  {task.name}: {task.remedy}")


def main() -> None:
    """Evaluate the mission three times."""
    mission, routes = ep.read_mission(bundled("mission_yard.yaml")), Routes()
    report = ep.evaluate(mission, routes=routes)
    tell("least energy", report)
    full = replace(mission, objective="length", soc=1.0)
    tell("shortest, from a full battery", ep.evaluate(full, routes=routes))
    (mast,) = [task for task in report.tasks if task.verdict == "unreachable"]
    remedy = next(one for one in mast.remedies if one.kind in ("charge", "capacity"))
    tell(f"with {remedy}", ep.evaluate(mission.with_remedy(remedy), routes=routes))


if __name__ == "__main__":
    main()
