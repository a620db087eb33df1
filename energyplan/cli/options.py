"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

OUTPUTS = "energyplan.outputs"
"""Where the context of a command keeps the files that it will write."""
IMAGES = (".png", ".svg", ".pdf")
TABLES = (".csv", ".gz", ".parquet", ".pq")
YAML = (".yaml", ".yml")
HTML = (".html", ".htm")


def writes(*suffixes: str) -> Callable[..., Path | None]:
    """Return the callback of an option that names a file to be written.

    Such an option is checked before the command begins: its suffix, its folder, and that it is none
    of the files that are read.
    """

    def callback(ctx: typer.Context, param: typer.CallbackParam, value: Path | None) -> Path | None:
        from energyplan.io.files import check_output

        if value is not None and not ctx.resilient_parsing:
            check_output(value, suffixes)
            ctx.meta.setdefault(OUTPUTS, {})[param.name] = value
        return value

    return callback


def writes_folder(
    ctx: typer.Context, param: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check a folder of output before the command begins; the callback of such an option."""
    from energyplan.io.files import check_output_folder

    if value is not None and not ctx.resilient_parsing:
        check_output_folder(value)
        ctx.meta.setdefault(OUTPUTS, {})[param.name] = value
    return value


def _complete(*kinds: str) -> Callable[[str], list[str]]:
    """Return the completion of an option that names a preset."""

    def complete(incomplete: str) -> list[str]:
        from energyplan.io.topics import TOPIC_MAPS
        from energyplan.power.presets import MODEL_PRESETS
        from energyplan.vehicle.presets import VEHICLE_PRESETS

        known = {"vehicle": VEHICLE_PRESETS, "model": MODEL_PRESETS, "topics": TOPIC_MAPS}
        names = [*(name for kind in kinds for name in known[kind]), *_yaml_files(incomplete)]
        return [name for name in names if name.startswith(incomplete)]

    return complete


def _yaml_files(incomplete: str) -> list[str]:
    folder = Path(incomplete).parent if incomplete else Path()
    try:
        return [str(file) for file in sorted(folder.glob("*.y*ml"))]
    except OSError:
        return []


Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Strict = Annotated[bool, typer.Option("--strict", help="End with exit code 3 if the answer is no.")]
Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...", help="Drive logs: CSV, CSV.gz, Parquet, bags, Husky recordings."
    ),
]
VehicleName = Annotated[
    str,
    typer.Option(
        "--vehicle",
        metavar="VEHICLE",
        help="A preset such as husky_a200, or a YAML file.",
        autocompletion=_complete("vehicle"),
    ),
]
ModelName = Annotated[
    str,
    typer.Option(
        "--model",
        metavar="MODEL",
        help="A preset such as husky_a200:flooring, or a YAML file.",
        autocompletion=_complete("model"),
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=COLUMN,...",
        help="Columns with other names or units: v_left=velL,yaw=heading[deg]; or a YAML file.",
    ),
]
Topics = Annotated[
    str | None,
    typer.Option(
        metavar="TOPICS",
        help="Which topics of a bag to read: husky, jackal, warthog, or a YAML file.",
        autocompletion=_complete("topics"),
    ),
]
OutModel = Annotated[
    Path | None,
    typer.Option("--out", callback=writes(*YAML), help="Write the model to this YAML file."),
]
Report = Annotated[
    Path | None,
    typer.Option("--report", callback=writes(*HTML), help="Write a report to this HTML file."),
]
