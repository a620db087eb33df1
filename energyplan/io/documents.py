"""What files hold that may be hostile: bounded size, nothing outside their folder.

Complaints about a YAML document name its line. An amount may have a unit.
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import reduce
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, TypeVar, get_args

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from energyplan.errors import InvalidInputError, MapError
from energyplan.records import NO_NUMBER, Doubts, ImpossibleError, in_words, warn
from energyplan.records import Checked as Checked

MAX_JSON = 2**26
"""Largest JSON file that is read [bytes]."""


def read_bytes(
    file: Path,
    limit: int,
    error: type[InvalidInputError] = MapError,
    remedy: str = "crop or coarsen it",
) -> bytes:
    """Return a file's content."""
    try:
        if file.exists() and not file.is_file() and not file.is_dir():
            raise ValueError("it is no regular file")  # a pipe would be waited for
        with file.open("rb") as stream:
            content = stream.read(limit + 1)
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"{str(file)!r} cannot be read: {reason}") from None
    if len(content) > limit:
        raise error(f"{file} is larger than {limit >> 10} KiB; {remedy}")
    return content


def read_json(file: Path, limit: int, error: type[InvalidInputError], remedy: str) -> Any:
    """Return what a JSON file holds; parameters and errors as in `read_bytes`."""
    content = read_bytes(file, limit, error, remedy)
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as problem:
        raise error(f"{file} is no JSON: {problem}; {remedy}") from None


def beside(file: Path, key: str, name: str) -> Path:
    """Return the file that another file names, if it lies in that one's folder or below."""
    if PurePosixPath(name).is_absolute() and Path(name).parent == file.resolve().parent:
        name = Path(name).name  # as ROS 1's map_saver writes it
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive != ""
    if absolute or ".." in PurePosixPath(name.replace("\\", "/")).parts or "\0" in name:
        raise MapError(
            f"{file}: {key}: {name!r} leaves the file's folder; put it beside the file and name "
            "it alone"
        )
    try:
        folder = file.resolve().parent
        target = (folder / name).resolve()
    except (OSError, RuntimeError) as error:
        raise MapError(f"{file}: {key}: {name!r} cannot be followed: {error}") from None
    if not target.is_relative_to(folder):
        raise MapError(
            f"{file}: {key}: {name!r} is a link out of the file's folder; copy the target there"
        )
    return target


_GIS = (".shp", ".shx", ".dbf", ".gpkg", ".kml", ".kmz", ".gml", ".gpx", ".dxf", ".fgb", ".tab")
"""Files of areas that ogr2ogr converts."""


def read_features(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return a GeoJSON document and its features."""
    if file.suffix.lower() in _GIS:
        raise MapError(
            f"{file} is a file of a geographic information system; make GeoJSON of it, in metres "
            f"of the map: ogr2ogr -f GeoJSON {file.stem}.geojson {file.name}"
        )
    document = read_json(
        file, MAX_JSON, MapError, "give a GeoJSON file, of a part if it is too large"
    )
    features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(document, dict) or not isinstance(features, list):
        raise MapError(f"{file}: give a GeoJSON FeatureCollection with a list of features")
    for k, feature in enumerate(features):
        if not isinstance(feature, dict):
            raise MapError(f"{file}: feature {k} is no object; give a GeoJSON Feature")
        if not isinstance(feature.get("geometry"), dict):
            raise MapError(f"{file}: feature {k} has no geometry")
        if feature.get("properties") is None:
            feature["properties"] = {}
        if not isinstance(feature["properties"], dict):
            raise MapError(f"{file}: the properties of feature {k} are no object")
    return document, features


def unused(given: Iterable[Any], used: Collection[str], idle: Collection[str]) -> list[str]:
    """Return keys that a reader does not use, but for those that change no answer, each once.

    Every reader of another tool's file names them, and lists the idle ones with their reasons.
    """
    return [key for key in dict.fromkeys(map(str, given)) if key not in used and key not in idle]


def warn_of_unused(place: str, keys: Sequence[str]) -> None:
    """Warn of keys that are not used, if there are any."""
    if keys:
        more = f" and {len(keys) - 10} more" if len(keys) > 10 else ""
        warn(f"{place}: keys that are not used: {', '.join(keys[:10])}{more}", stacklevel=4)


MAX_BYTES = 1 << 20
"""Largest YAML file that is read [bytes]."""
MAX_NODES = 50_000
"""Most values in a document, aliases written out."""
_MAX_DEPTH = 40
_TEXT = re.compile(r"[-+]?0[0-9_]+|[-+]?[0-9_]+(:[0-9_.]+)+|[0-9]{4}-[0-9][0-9]?-[0-9].*")
"""What YAML 1.1 takes for a number of base 8 or 60, or for a date; it stays what is written."""
MAP = "a map of map_server"
_TELLING = {
    MAP: {"image", "resolution"},
    "a building of Open-RMF": {"levels"},
    "a mission": {"tasks", "battery"},
    "a site": {"map", "clearance"},
    "a mission of several robots": {"robots"},
    "a power model": {"terms"},
    "a vehicle": {"mass", "track"},
    "a project": {"vehicle", "columns"},
    "an order of VDA 5050: give it as the tasks of a mission, as in tasks: order.json": {
        "orderId",
        "nodes",
    },
    "a plan of QGroundControl, over longitude and latitude: write its waypoints in metres of the "
    "map, as in tasks: [{name: w1, pose: [X, Y, YAW]}]": {"fileType", "mission"},
    "waypoints of Nav2: give them as the tasks of a mission, as in tasks: waypoints.yaml": {
        "waypoints"
    },
    "a map of OpenMower: draw its areas as GeoJSON polygons, in metres, under surfaces": {
        "areas",
        "docking_stations",
    },
    "Clearpath's robot.yaml: give its robot by name, such as husky_a200 or jackal, or start with "
    "--like robot.yaml": {"serial_number", "platform"},
}
"""Keys by which a file shows what it is."""
_PARAMETERS = "ros__parameters"
_OF_ROS = (
    "a parameters file of ROS 2: of a vector object server, give the areas to keep out of as "
    "GeoJSON polygons with keep_out, under surfaces; of a planner, the map that it names"
)
_IN_DEGREES = (
    ", over longitude and latitude: write them in metres of the map, as in tasks: [{name: w1, "
    "pose: [X, Y, YAW]}]"
)
_GOALS = "write its goals as tasks: [{name: a, pose: [X, Y, YAW]}]"
_BEGINS = {
    rb"QGC WPL": f"waypoints of MAVLink{_IN_DEGREES}",
    rb"(<\?xml[^>]*>\s*)?<gpx": f"GPX, waypoints or tracks{_IN_DEGREES}",
    rb"(<\?xml[^>]*>\s*)?<kml": f"KML, places or tracks{_IN_DEGREES}",
    rb"<root": f"XML, such as a behaviour tree: {_GOALS}",
    rb"<(\?xml|\w)": f"XML, such as a behaviour tree or a launch file: {_GOALS}",
    rb"\x89PNG": "an image: name it in the YAML file of a map, as image: FILE.png",
    rb"P[25]\s": "an image: name it in the YAML file of a map, as image: FILE.pgm",
    rb"PK\x03\x04": "a zip archive, as spreadsheets are: export a table as CSV",
    rb"SQLite format 3": "a database of SQLite, as ROS 2 bags are: it is no configuration",
    rb"\x89MCAP": "a bag (MCAP): it is no configuration",
}
"""What a file is that is no YAML, by how it begins, as regular expressions."""
_PLAIN = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")

_EXTRA = ("extra_forbidden", "unexpected_keyword_argument")
NO_CONFIGURATION = "that is no configuration"

Loc = tuple[int | str, ...]
T = TypeVar("T")


@dataclass(frozen=True)
class Document:
    """A YAML document and the lines of its values."""

    source: str  # name of the file, for messages
    data: Any  # mappings, lists and scalars
    lines: dict[Loc, int]  # line of each value by its place, a tuple of keys and indices
    error: type[InvalidInputError]  # error to raise for bad content

    def fail(self, loc: Sequence[int | str], problem: str) -> InvalidInputError:
        """Return the error for a place."""
        return self.error(f"{self.where(loc)}: {problem}")

    def where(self, loc: Sequence[int | str]) -> str:
        """Return a place with its line; of a missing value the line is that of its parent."""
        place = tuple(loc)
        known = place
        while known and known not in self.lines:
            known = known[:-1]
        name = in_words(place)
        # what no file holds, such as the options of a command, has no lines
        where = f"{self.source}, line {self.lines.get(known, 1)}" if self.lines else self.source
        return f"{where}{f', {name}' if name else ''}"

    def warn(self, unusual: Doubts, loc: Loc = ()) -> None:
        """Warn of unusual values with their lines."""
        for place, text in unusual:
            warn(f"{self.where((*loc, *place))}: {text}", stacklevel=5)

    def check(self, schema: type[T], loc: Loc = (), context: Any = None) -> T:
        """Return what stands at a place, checked by a pydantic model, dataclass or annotation."""
        try:
            value = reduce(lambda held, key: held[key], loc, self.data)
            return TypeAdapter(schema).validate_python(value, context=context or {})
        except ValidationError as problem:
            every = problem.errors(include_url=False)
            places = [self._keys_of(one, value) for one in every]
            # Where one of several kinds may stand, what is wrong within the kind that stands there.
            depth = len(places[0])
            which = max(
                (k for k, place in enumerate(places) if place[:depth] == places[0]),
                key=lambda k: len(places[k]),
            )
            if every[which]["type"] == "missing":  # perhaps since it is misspelt
                extra = [k for k, one in enumerate(every) if one["type"] in _EXTRA]
                which = min(extra, key=lambda k: len(places[k]), default=which)
            first, place = every[which], places[which]
            message = str(first["msg"]).removeprefix("Value error, ")
            why = first.get("ctx", {}).get("error")
            own, item = getattr(why, "place", ()), first["input"]
            if isinstance(why, ImpossibleError) and own:
                item = why.value
            if first["type"] in _EXTRA:
                keys = _keys(schema, place)
                near = get_close_matches(str(place[-1]), keys, 1)
                message = f"did you mean {near[0]}? " if near else ""
                message = f"there is no such key; {message}the keys are {', '.join(keys)}"
            elif first["type"] == "missing":
                message = "this key is missing; give it a value"
                lacking = [
                    str(at[-1])
                    for at, one in zip(places, every, strict=True)
                    if one["type"] == "missing" and at[:-1] == place[:-1]
                ]
                if len(lacking) > 1:
                    message = f"the keys {', '.join(lacking)} are missing; give each a value"
                    place = place[:-1]
            elif first["type"] == "too_short":
                message = (
                    f"the list has {first['ctx']['actual_length']} items; give at least "
                    + str(first["ctx"]["min_length"])
                )
            elif isinstance(why, ImpossibleError) or not (own or isinstance(item, dict | list)):
                message = f"{message}, not {str(item)[:60]!r}"
                if re.fullmatch(r"\s*[-+]?\d+,\d+\D*", str(item)) and "number" in message:
                    message += f"; write {str(item).strip().replace(',', '.')}"
            raise self.fail((*loc, *place, *own), message + self.another_kind(schema)) from None

    def _keys_of(self, problem: ErrorDetails, here: Any) -> Loc:
        """Return where in a value a problem is, without the names of kinds that may stand."""
        found: list[int | str] = []
        *_, last = problem["loc"] or ("",)
        for part in problem["loc"]:
            held: dict[Any, Any] = here if isinstance(here, dict) else {}
            if isinstance(here, list):
                held = dict(enumerate(here))
            if part in held:
                here = held[part]
            elif part != last or problem["type"] != "missing":
                continue
            found.append(part)
        return tuple(found)

    @property
    def kind(self) -> str | None:
        """What the file seems to be, by its keys."""
        return next(self._kinds({*self.data}), None)

    def _kinds(self, strange: set[Any]) -> Iterator[str]:
        """Yield what the file may be, by keys of which some are strange."""
        if any(isinstance(one, dict) and _PARAMETERS in one for one in self.data.values()):
            yield _OF_ROS
        for kind, keys in _TELLING.items():
            if keys & strange and keys <= {*self.data}:
                yield kind

    def another_kind(self, schema: Any) -> str:
        """Say what else the file seems to be, if anything."""
        strange = {*self.data} - {*_fields(schema)}
        kind = next(self._kinds(strange), None)
        return f"; this file seems to be {kind}" if kind else ""


def _keys(here: Any, loc: Loc) -> list[str]:
    """Return the keys that a mapping may have."""
    for part in loc[:-1]:
        field = _fields(here).get(str(part))
        found = [] if field is None else [field.annotation]
        for kind in found:  # grows by what a list or a choice holds
            found += get_args(kind)
        here = next((kind for kind in found if _fields(kind)), here)
    return list(_fields(here))


def _fields(schema: Any) -> dict[str, Any]:
    """Return the fields of a pydantic model or dataclass by the keys of a mapping."""
    known = getattr(schema, "__pydantic_fields__", {}).items()
    own = {name: one for name, one in known if one.init is not False}
    return own | dict.fromkeys(getattr(schema, "also", ()))


def load(path: str | Path, error: type[InvalidInputError]) -> Document:
    """Read one YAML document that holds a mapping."""
    file = Path(path)
    content, known = read_bytes(file, MAX_BYTES, error, NO_CONFIGURATION), _parsed.get()
    if known is None:
        return parse(content, file.name, error)
    key = file.name, content
    if key not in known:
        try:
            known[key] = parse(content, file.name, InvalidInputError)
        except InvalidInputError as problem:
            known[key] = str(problem)
        while len(known) > _KEPT:
            known.pop(next(iter(known)))
    found = known[key]
    if isinstance(found, str):
        raise error(found)
    return replace(found, error=error)


_KEPT = 8  # documents, of up to 1 MiB each, that are kept for who reads them again
_parsed: ContextVar[dict[tuple[str, bytes], Document | str] | None] = ContextVar(
    "parsed", default=None
)


@contextmanager
def parsed_once() -> Iterator[None]:
    """Parse a file that is read several times inside, with the same content, only once."""
    token = _parsed.set({})
    try:
        yield
    finally:
        _parsed.reset(token)


def parse(content: bytes | str, source: str, error: type[InvalidInputError]) -> Document:
    """Parse one YAML document that holds a mapping; as `load`, from memory."""
    if len(content) > MAX_BYTES:
        raise error(f"{source} is larger than {MAX_BYTES >> 10} KiB; {NO_CONFIGURATION}")
    head = (content if isinstance(content, bytes) else content[:80].encode()).lstrip()
    for begin, what in _BEGINS.items():
        if re.match(begin, head):
            raise error(f"{source} is {what}")
    if isinstance(content, bytes) and content.rstrip().endswith(b"\n---"):
        content = content.rstrip()[:-3]  # ros2 topic echo ends a message so
    lines: dict[Loc, int] = {}
    builder = _Builder(source, error, lines)
    try:
        _few_events(content)
        root = yaml.compose(content, Loader=_Loader)
        data = None if root is None else builder.build(root, ())
    except RecursionError:
        raise error(f"{source} is nested too deeply; {NO_CONFIGURATION}") from None
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark
        line = "" if mark is None else f", line {mark.line + 1}"
        raise error(f"{source}{line} is no valid YAML: {problem.problem or problem}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as problem:
        _in_utf8(content, source, error)
        text = " ".join(str(problem).split())[:150]
        raise error(f"{source} is no valid YAML: {text}") from None
    if data is None:
        raise error(f"{source} is empty; it must hold keys with values")
    if not isinstance(data, dict):
        found = "; this is plain text, such as a table" if isinstance(data, str) else ""
        raise error(f"{source} must hold a mapping of keys to values{found}")
    return Document(source, data, lines, error)


def _in_utf8(content: bytes | str, source: str, error: type[InvalidInputError]) -> None:
    """Refuse bytes of another encoding by their line."""
    if isinstance(content, str) or content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return
    try:
        content.decode()
    except UnicodeDecodeError as problem:
        line = content.count(b"\n", 0, problem.start) + 1
        raise error(f"{source}, line {line} is not in UTF-8; save the file as UTF-8") from None


_EVENTS: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's is ten times as fast


def _few_events(content: bytes | str) -> None:
    """Refuse too many values, or too deep a nest, by the parser's events, before any node."""
    text = content.decode("utf-8", "replace") if isinstance(content, bytes) else content
    if len(re.findall(r"^%", text, re.MULTILINE)) > _MAX_DEPTH:  # each is compared with all others
        raise yaml.MarkedYAMLError(problem="too many directives")
    count, nests = 0, list[bool | None]()  # whether a key comes next; None in a list
    excess: Any = None
    with suppress(yaml.YAMLError, UnicodeError):  # are named where the nodes are composed
        for event in yaml.parse(content, Loader=_EVENTS):
            if isinstance(event, yaml.NodeEvent):
                key = nests[-1] if nests else None
                if key is not None:
                    nests[-1] = not key
                count += not key
            if isinstance(event, yaml.CollectionStartEvent):
                nests.append(True if isinstance(event, yaml.MappingStartEvent) else None)
            elif isinstance(event, yaml.CollectionEndEvent):
                nests.pop()
            if count > MAX_NODES or len(nests) > _MAX_DEPTH + 1:
                excess = event.start_mark
                break
    if excess is not None:
        problem = "too many values or too deep a nest"
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=excess)


class _Loader(yaml.SafeLoader):
    """Composes nodes, and refuses too many while it does.

    Python's parser reads what libyaml's refuses, such as a tag with a comma, so that counting
    libyaml's events alone lets some files through.
    """

    _left = MAX_NODES

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node; keys of mappings have no index, and are not counted."""
        self._left -= parent is None or index is not None
        if self._left < 0:
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem="too many values", problem_mark=mark)
        return super().compose_node(parent, index)


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
        except (*NO_NUMBER, yaml.YAMLError) as problem:
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
