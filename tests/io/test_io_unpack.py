"""Bags with compressed parts are read; damaged ones are refused by name."""

from __future__ import annotations

import pytest
from small_bags import POWER, TOPICS, record

from energyplan.errors import DriveLogError
from energyplan.io.logs import read_log

pytest.importorskip("rosbags")

KINDS = ("mcap-zstd", "mcap-lz4", "sqlite-message", "sqlite-file", "ros1-bz2", "ros1-lz4")


@pytest.mark.parametrize("kind", KINDS)
def test_compressed_bags_are_read_and_damaged_parts_refused_by_name(tmp_path, kind):
    """Bytes in the middle of the compressed part are lost; its beginning is overwritten."""
    path = record(tmp_path / ("drive.bag" if kind.startswith("ros1") else "drive"), kind)
    assert read_log(path, topics=TOPICS).power.tolist() == POWER
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    sound = file.read_bytes()
    magic = {"bz2": b"BZh9", "lz4": b"\x04\x22\x4d\x18"}.get(kind[-3:], b"\x28\xb5\x2f\xfd")
    start = sound.rindex(magic) if kind == "sqlite-message" else sound.index(magic)
    for spoiled in (
        sound[: start + 6] + bytes(20) + sound[start + 26 :],
        sound[:start] + b"none" + sound[start + 4 :],
    ):
        file.write_bytes(spoiled)
        with pytest.raises(DriveLogError, match="no sound bag"):
            read_log(path, topics=TOPICS)


def test_what_would_be_read_whole_before_it_is_known_for_a_bag_is_refused(tmp_path):
    file = tmp_path / "none.bag"
    file.write_bytes(bytes(10_000))
    with pytest.raises(DriveLogError, match="does not begin as a ROS 1 bag"):
        read_log(file, topics=TOPICS)
    (tmp_path / "metadata.yaml").write_bytes(b"a" * (9 << 20))
    with pytest.raises(DriveLogError, match=r"metadata\.yaml is larger than 8 MiB"):
        read_log(tmp_path, topics=TOPICS)


@pytest.mark.parametrize("kind", ["ros1-bz2", "ros1-lz4"])
def test_a_small_bag_that_unpacks_to_much_is_refused(tmp_path, monkeypatch, kind):
    file = record(tmp_path / "a.bag", kind, padding=1 << 20)
    assert file.stat().st_size < 1 << 15
    assert read_log(file, topics=TOPICS).power.tolist() == POWER
    monkeypatch.setattr("energyplan.io.bags._LARGEST_CHUNK", 1 << 19)
    with pytest.raises(DriveLogError, match="unpacks to over 0 MiB"):
        read_log(file, topics=TOPICS)
