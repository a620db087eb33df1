"""Tasks in the order given: where to charge, and what to leave out so that the rest can be done."""

from __future__ import annotations

from dataclasses import dataclass

from energyplan.mission.condition import Attempt, Condition, as_good
from energyplan.mission.simulation import Walk


@dataclass(frozen=True)
class Course:
    """A way through the tasks in the order given.

    Parameters
    ----------
    state : Condition
        Where it ends.
    worth : float
        Worth of what was done.
    steps : tuple of (int, Condition, Attempt)
        The tasks done, each with the condition before it and its attempt.
    """

    state: Condition
    worth: float = 0.0
    steps: tuple[tuple[int, Condition, Attempt], ...] = ()

    @property
    def rank(self) -> tuple[float, tuple[int, ...]]:
        """Sort by worth, then by who comes first in the order given; the best one is least."""
        return -self.worth, tuple(step[0] for step in self.steps)

    def beats(self, other: Course) -> bool:
        """Tell whether nothing speaks for the other one."""
        return self.rank <= other.rank and as_good(self.state, other.state)


def best_course(walk: Walk) -> Course:
    """Do the tasks in the order given; charge before any of them, leave out what is worth less.

    Tasks are done one after the other as long as the battery lasts. Where it does not, all ways
    are followed side by side: with and without a charge before each task, with and without the
    task. Of two at the same place, the one that is worse in every respect is dropped.

    Parameters
    ----------
    walk : Walk
        The mission.

    Returns
    -------
    Course
        The way of greatest worth from which the mission can end; of those the one that does the
        tasks that come first, with the least energy. Where none can end, the one of greatest worth.
    """
    tasks = walk.mission.tasks
    whole = sum(task.prize for task in tasks) + 1.0
    worths = [task.prize + whole * task.required for task in tasks]
    direct = Course(walk.start)
    for k in range(len(tasks)):
        attempt = walk.attempt(direct.state, k)
        if attempt.reason != "none":
            break
        step = (k, direct.state, attempt)
        direct = Course(attempt.after, direct.worth + worths[k], (*direct.steps, step))
    else:
        if walk.finish(direct.state) is not None:
            return direct
    courses = [Course(walk.start)]
    for k in range(len(tasks)):
        grown = list(courses)
        for course in courses:
            ahead = [range(k, last + 1) for last in range(k, len(tasks))]
            for before in (course.state, *walk.charged(course.state, ahead)):
                for hurried in walk.ways:
                    attempt = walk.attempt(before, k, hurried)
                    if attempt.reason == "none":
                        step = (k, course.state, attempt)
                        worth = course.worth + worths[k]
                        grown.append(Course(attempt.after, worth, (*course.steps, step)))
        courses = []
        for course in sorted(grown, key=lambda c: (c.rank, c.state.total.mean)):
            if not any(kept.beats(course) for kept in courses):
                courses.append(course)
    ranked = sorted(courses, key=lambda c: (c.rank, c.state.total.mean))
    return next((c for c in ranked if walk.finish(c.state) is not None), ranked[0])
