"""YAML documents of bounded size, whose complaints name the line."""

from __future__ import annotations

import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError, ValidationInfo, field_validator

from energyplan.errors import InvalidInputError

MAX_BYTES = 1 << 20
"""Largest YAML file that is read [bytes]."""
MAX_NODES = 50_000
"""Most values in a document, aliases written out."""
_MAX_DEPTH = 40
_TEXT = re.compile(r"[-+]?0[0-9_]+|[-+]?[0-9_]+(:[0-9_.]+)+|[0-9]{4}-[0-9][0-9]?-[0-9].*")
"""What YAML 1.1 takes for a number of base 8 or 60, or for a date; it stays what is written."""
_PLAIN = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")

Loc = tuple[int | str, ...]
M = TypeVar("M", bound=BaseModel)


class Checked(BaseModel):
    """What a mapping holds: no number is written as true or false."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth(cls, value: Any, info: ValidationInfo) -> Any:
        parts = value if isinstance(value, list) else [value]
        kind = cls.model_fields[info.field_name or ""].annotation
        allowed = kind in (Any, bool) or bool in get_args(kind)
        if not allowed and any(isinstance(part, bool) for part in parts):
            raise ValueError("Input should be a number or a text")
        return value


@dataclass(frozen=True)
class Document:
    """A YAML document and the lines of its values.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    data : object
        Mappings, lists and scalars.
    lines : dict
        Line of each value by its place, a tuple of keys and indices.
    error : type
        Error to raise for bad content.
    """

    source: str
    data: Any
    lines: dict[Loc, int]
    error: type[InvalidInputError]

    def fail(self, loc: Sequence[int | str], problem: str) -> InvalidInputError:
        """Return the error for a place; of a missing value the line is that of its parent."""
        place = tuple(loc)
        known = place
        while known and known not in self.lines:
            known = known[:-1]
        name = ".".join(str(part) for part in place)
        # what no file holds, such as the options of a command, has no lines
        where = f"{self.source}, line {self.lines.get(known, 1)}" if self.lines else self.source
        return self.error(f"{where}{f', {name}' if name else ''}: {problem}")

    def check(self, schema: type[M], loc: Loc = ()) -> M:
        """Return the document as checked by a pydantic model.

        Raises
        ------
        InvalidInputError
            Of the document's kind, naming the line and the key.
        """
        try:
            return schema.model_validate(self.data)
        except ValidationError as problem:
            every = problem.errors(include_url=False)
            first = every[0]
            if first["type"] == "missing":  # perhaps since it is misspelt
                extra = [one for one in every if one["type"] == "extra_forbidden"]
                first = min(extra, key=lambda one: len(one["loc"]), default=first)
            message = str(first["msg"]).removeprefix("Value error, ")
            if first["type"] == "extra_forbidden":
                message = f"there is no such key; the keys are {_keys(schema, first['loc'])}"
            elif first["type"] == "missing":
                message = "this key is missing; give it a value"
            elif first["type"] == "too_short":
                message = (
                    f"the list has {first['ctx']['actual_length']} items; give at least "
                    + str(first["ctx"]["min_length"])
                )
            elif not isinstance(first["input"], dict | list):
                message = f"{message}, not {str(first['input'])[:60]!r}"
            raise self.fail((*loc, *first["loc"]), message) from None


def _keys(schema: type[BaseModel], loc: tuple[int | str, ...]) -> str:
    """Name the keys that a mapping may have."""
    here: Any = schema
    for part in loc[:-1]:
        field = here.model_fields.get(part) if hasattr(here, "model_fields") else None
        options = (
            [] if field is None else [field.annotation, *getattr(field.annotation, "__args__", ())]
        )
        models = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        here = models[0] if models else here
    return ", ".join(here.model_fields)


def load(path: str | Path, error: type[InvalidInputError]) -> Document:
    """Read one YAML document that holds a mapping.

    Parameters
    ----------
    path : str or Path
        The file.
    error : type
        Error to raise for bad content.

    Returns
    -------
    Document
        The document.

    Raises
    ------
    InvalidInputError
        As the given `error`: the file is missing, too large, no YAML, or names a key twice.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise error(f"{str(file)!r} cannot be read: {reason}") from None
    return parse(content, file.name, error)


def parse(content: bytes | str, source: str, error: type[InvalidInputError]) -> Document:
    """Parse one YAML document that holds a mapping; as `load`, from memory."""
    if len(content) > MAX_BYTES:
        raise error(f"{source} is larger than {MAX_BYTES >> 10} KiB; that is no configuration")
    lines: dict[Loc, int] = {}
    builder = _Builder(source, error, lines)
    try:
        root = yaml.compose(content, Loader=yaml.SafeLoader)
        data = None if root is None else builder.build(root, ())
    except RecursionError:
        raise error(f"{source} is nested too deeply; that is no configuration") from None
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark
        line = "" if mark is None else f", line {mark.line + 1}"
        raise error(f"{source}{line} is no valid YAML: {problem.problem or problem}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as problem:
        text = " ".join(str(problem).split())[:150]
        raise error(f"{source} is no valid YAML: {text}") from None
    if not isinstance(data, dict):
        raise error(f"{source} must hold a mapping of keys to values")
    return Document(source, data, lines, error)


class _Builder:
    """Turns nodes into values, so that keys named twice and alias bombs are seen."""

    def __init__(self, source: str, error: type[InvalidInputError], lines: dict[Loc, int]) -> None:
        self._source, self._error, self._lines, self._left = source, error, lines, MAX_NODES
        self._scalars = yaml.SafeLoader("")

    def build(self, node: yaml.Node, loc: Loc) -> Any:
        """Return the value of a node."""
        line = node.start_mark.line + 1
        self._left -= 1
        if self._left < 0 or len(loc) > _MAX_DEPTH:
            raise self._error(f"{self._source}, line {line}: too many values or too deep a nest")
        self._lines.setdefault(loc, line)
        if not isinstance(node, yaml.ScalarNode) and node.tag not in _PLAIN:
            raise self._error(f"{self._source}, line {line}: leave the tag {node.tag!r} out")
        if isinstance(node, yaml.SequenceNode):
            return [self.build(item, (*loc, k)) for k, item in enumerate(node.value)]
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, loc)
        plain = isinstance(node, yaml.ScalarNode) and node.style is None
        if plain and _TEXT.fullmatch(node.value):
            return str(node.value)
        try:
            return self._scalars.construct_object(node)
        except (ValueError, yaml.YAMLError, OverflowError) as problem:
            text = getattr(problem, "problem", None) or problem
            raise self._error(
                f"{self._source}, line {line}: {str(node.value)[:60]!r} cannot be read: {text}"
            ) from None

    def _mapping(self, node: yaml.MappingNode, loc: Loc) -> dict[Hashable, Any]:
        found: dict[Hashable, Any] = {}
        for name, item in node.value:
            line = name.start_mark.line + 1
            if not isinstance(name, yaml.ScalarNode):
                raise self._error(f"{self._source}, line {line}: a key must be a plain word")
            key = str(name.value)
            if key in found:
                raise self._error(f"{self._source}, line {line}: {key!r} stands twice; drop one")
            self._lines[(*loc, key)] = line
            found[key] = self.build(item, (*loc, key))
        return found
