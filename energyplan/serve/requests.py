"""What requests hold, with the bounds of every number."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

LONGEST, MOST_EFFORT = 60.0, 5_000_000
"""Largest time limit [s] and effort that a request may ask for."""

MOST_ROWS = 200_000
"""Largest number of samples of a trajectory in a request."""

PoseRow = Annotated[list[float], Field(min_length=3, max_length=3, examples=[[2.0, 2.0, 0.0]])]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class PlanRequest(_Asked):
    """A planning problem; files are named as the data folder has them."""

    map: Name
    model: Name = Field(examples=["quadriga:full:concrete"])
    start: PoseRow
    goal: PoseRow
    surfaces: Name | None = None
    heights: Name | None = None
    battery: bool = False
    clearance: float = Field(0.0, ge=0, le=100)
    keepout: Name | None = None
    objective: Literal["energy", "length", "time"] = "energy"
    planner: Name = "lattice"
    time_limit: float = Field(1.0, gt=0, le=LONGEST)
    effort: int | None = Field(None, ge=1, le=MOST_EFFORT)


class RangeRequest(_Asked):
    """From where, and what there is: an energy [J], or the charge of a battery."""

    map: Name
    model: Name = Field(examples=["quadriga:full:concrete"])
    start: PoseRow
    back: PoseRow | None = Field(None, description="a pose to get back to, such as a charger's")
    energy: float | None = Field(None, gt=0)
    pack: Name | None = Field(None, description="name of a battery", examples=["quadriga"])
    soc: float = Field(1.0, gt=0, le=1)
    reserve: float = Field(0.0, ge=0, lt=1)
    confidence: float | None = Field(None, gt=0, lt=1)
    coefficient_spread: float = Field(0.0, ge=0, lt=1)
    surfaces: Name | None = None


class CheckRequest(_Asked):
    """A trajectory by its columns, and the model whose motors drive it."""

    model: Name
    t: list[float] = Field(min_length=2, max_length=MOST_ROWS)
    x: list[float] = Field(max_length=MOST_ROWS)
    y: list[float] = Field(max_length=MOST_ROWS)
    yaw: list[float] = Field(max_length=MOST_ROWS)
    v: list[float] = Field(max_length=MOST_ROWS)
    omega: list[float] = Field(max_length=MOST_ROWS)


class MissionRequest(_Asked):
    """A mission: a file of the data folder, or what such a file would hold."""

    mission: Name | None = None
    document: dict[str, Any] | None = None


class IdentifyRequest(_Asked):
    """Drive logs of the data folder."""

    logs: list[Name] = Field(min_length=1, max_length=100)
    vehicle: Name


class DiagnoseRequest(IdentifyRequest):
    """Drive logs to learn from and to judge by."""

    holdout: list[Name] = Field(min_length=1, max_length=100)
