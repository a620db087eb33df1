"""A few kilobytes that unpack to more than they may are refused, wherever a bag can hold them."""

from __future__ import annotations

import bz2

import pytest
from small_bags import COUNT, POWER, TOPICS, record

from energyplan.errors import DriveLogError
from energyplan.io import bags
from energyplan.io.bags import bag_info, read_bag, unpacked

pytest.importorskip("rosbags")
lz4 = pytest.importorskip("lz4.frame")
zstd = bags._zstd()

KINDS = ("mcap-zstd", "mcap-lz4", "sqlite-message", "sqlite-file", "ros1-bz2", "ros1-lz4")


def recorded(folder, kind, padding=0):
    return record(folder / ("drive.bag" if kind.startswith("ros1") else "drive"), kind, padding)


@pytest.mark.parametrize("kind", KINDS)
def test_compressed_bags_are_read(tmp_path, kind):
    log = read_bag(recorded(tmp_path, kind), TOPICS)
    assert log.power.tolist() == POWER


@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_unpacks_to_too_much_is_refused(tmp_path, kind, monkeypatch):
    path = recorded(tmp_path, kind, padding=1 << 23)
    files = [path] if path.is_file() else [f for f in path.iterdir() if f.name != "metadata.yaml"]
    assert sum(f.stat().st_size for f in files) < 1 << 17
    assert len(read_bag(path, TOPICS).t) == COUNT
    monkeypatch.setattr(bags, "LARGEST", 1 << 22)
    monkeypatch.setattr(bags, "LARGEST_RATIO", 10)
    with pytest.raises(DriveLogError, match=r"no sound bag: a compressed .* (more|too large)"):
        read_bag(path, TOPICS)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_parts_are_refused_by_name(tmp_path, kind):
    """Bytes in the middle of the compressed part are lost; its beginning is overwritten."""
    path = recorded(tmp_path, kind)
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
            read_bag(path, TOPICS)


@pytest.mark.parametrize(
    ("make", "pack"),
    [
        (bz2.BZ2Decompressor, bz2.compress),
        (lz4.LZ4FrameDecompressor, lz4.compress),
        (zstd.ZstdDecompressor, zstd.compress),
    ],
)
def test_parts_unpack_up_to_what_they_may_hold(make, pack):
    data = bytes(range(256)) * 40
    packed = pack(data)
    assert unpacked(make, packed, len(data)) == data
    assert unpacked(make, packed + packed, 2 * len(data)) == data + data
    assert unpacked(make, pack(b""), 0) == b""
    with pytest.raises(ValueError, match="holds more"):
        unpacked(make, packed, len(data) - 1)
    with pytest.raises(ValueError, match="holds more"):
        unpacked(make, packed + packed, 2 * len(data) - 1)
    for short in (packed[:-1], packed[:9], b""):
        with pytest.raises(ValueError, match="ends early"):
            unpacked(make, short)
    with pytest.raises(ValueError, match="damaged"):
        unpacked(make, b"no such thing" * 9)


def test_what_would_be_read_whole_before_it_is_known_for_a_bag_is_refused(tmp_path):
    file = tmp_path / "none.bag"
    file.write_bytes(bytes(10_000))
    with pytest.raises(DriveLogError, match="does not begin as a ROS 1 bag"):
        bag_info(file)
    (tmp_path / "metadata.yaml").write_bytes(b"a" * (9 << 20))
    with pytest.raises(DriveLogError, match=r"metadata\.yaml is larger than 8 MiB"):
        bag_info(tmp_path)
