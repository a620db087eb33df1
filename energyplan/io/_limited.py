"""Reading map files that may be hostile: bounded size, nothing outside their folder."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from energyplan.errors import MapError

MAX_TEXT = 2**26
"""Largest GeoJSON file that is read [bytes]."""


def read_bytes(file: Path, limit: int) -> bytes:
    """Return a file's content.

    Parameters
    ----------
    file : Path
        The file.
    limit : int
        Largest size [bytes].

    Returns
    -------
    bytes
        Its content.

    Raises
    ------
    MapError
        If it cannot be read or is larger.
    """
    try:
        with file.open("rb") as stream:
            content = stream.read(limit + 1)
    except OSError as error:
        raise MapError(f"{file}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise MapError(f"{str(file)!r}: no usable file name: {error}") from None
    if len(content) > limit:
        raise MapError(f"{file}: larger than {limit} bytes; crop or coarsen it")
    return content


def beside(file: Path, key: str, name: str) -> Path:
    """Return the file that another file names, if it lies in that one's folder or below.

    Parameters
    ----------
    file : Path
        The file that holds the name.
    key : str
        Where in it, for the message.
    name : str
        The name.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MapError
        If it lies elsewhere, be it by an absolute path, by ``..`` or by a link.
    """
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


def read_features(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return a GeoJSON document and its features.

    Parameters
    ----------
    file : Path
        The file.

    Returns
    -------
    dict
        The whole document.
    list of dict
        Its features, each with a geometry and properties that are objects.

    Raises
    ------
    MapError
        If it is not a GeoJSON FeatureCollection; the message names the feature.
    """
    content = read_bytes(file, MAX_TEXT)
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise MapError(f"{file}: not valid JSON: {error}; give a GeoJSON file") from None
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
