"""The bound on what was fetched: what goes, what stays, and what waits."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import happened
from tests.support.waiting import eventually

from rsb_extras.courier import RecordingFolders
from rsb_extras.courier.courier_part import FetchProblem
from rsb_extras.courier.courier_requests import FetchState
from rsb_extras.courier.fetched_folder import FolderFullError, make_room
from rsb_extras.courier.link_courier import CourierCode
from rsb_extras.courier.tests.bags import messages, write_bag
from rsb_extras.courier.tests.courier_bed import done, fetch, report, slow_link, two_sides
from rsb_extras.courier.tests.courier_places import BOUNDED_EACH, DISK_AGAIN_AFTER

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge

MEGABYTE = 1_000_000
SMALL = RecordingFolders(fetched=0.01)


def put(path: Path, at: int, mode: int = 0o600) -> Path:
    """Write a file of 4 MB, at so many seconds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(4 * MEGABYTE))
    path.chmod(mode)
    os.utime(path, (at, at))
    return path


def test_the_oldest_files_go(tmp_path: Path) -> None:
    files = [put(tmp_path / name, at) for at, name in enumerate(("b.mcap", "c.mcap", "a.mcap"))]
    assert make_room(tmp_path, 0.02) == []
    assert make_room(tmp_path, 0.005) == files[:2]
    assert [*tmp_path.iterdir()] == files[2:]


def test_what_an_operator_keeps_stays(tmp_path: Path) -> None:
    kept = put(tmp_path / "kept.mcap", 0, 0o400)
    put(tmp_path / "notes.txt", 0)
    put(tmp_path / "own" / "run_0.mcap", 0)
    old = put(tmp_path / "old.mcap", 1)
    elsewhere = put(tmp_path.with_name("elsewhere") / "large.mcap", 0)
    (tmp_path / "link.mcap").symlink_to(elsewhere)
    assert make_room(tmp_path, 0.013) == [old]
    assert kept.exists()
    assert elsewhere.exists()
    with pytest.raises(FolderFullError, match=r"0\.012 of 0\.01 GB"):
        make_room(tmp_path, 0.01)


def test_what_is_under_way_counts_and_stays(tmp_path: Path) -> None:
    piece = put(tmp_path / ".drive.fetch" / "00000001.piece", 0)
    part = put(tmp_path / ".drive.mcap.part", 0)
    old = put(tmp_path / "old.mcap", 1)
    assert make_room(tmp_path, 0.01) == [old]
    assert piece.exists()
    assert part.exists()
    new = put(tmp_path / "new.mcap", 1)
    with pytest.raises(FolderFullError):
        make_room(tmp_path, 0.007)
    assert new.exists(), "nothing goes in vain"


def test_a_folder_that_is_not_there_has_room(tmp_path: Path) -> None:
    assert make_room(tmp_path / "fetched", 1) == []


def test_an_older_fetch_makes_room_and_is_named(bridge: Bridge, bags: Path, fetched: Path) -> None:
    write_bag(bags / "drive.mcap", messages(1))
    old = put(fetched / "old.mcap", 1)
    kept = put(fetched / "kept.mcap", 0, 0o400)
    newer = [put(fetched / f"newer{at}.mcap", 1 + at) for at in range(1, 3)]
    pc, _ = two_sides(bridge, bags, own=SMALL)
    done(pc, fetch(pc, "drive.mcap"))
    assert happened(pc, CourierCode.REMOVED, FetchProblem.REMOVED, path=old, most=0.01)
    assert not old.exists()
    assert all(each.exists() for each in (kept, newer[1]))


def test_a_fetch_beyond_the_bound_waits_for_room(
    bridge: Bridge, bags: Path, fetched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    BOUNDED_EACH.set(monkeypatch, MEGABYTE)
    DISK_AGAIN_AFTER.set(monkeypatch, 0.5)
    write_bag(bags / "drive.mcap", messages(40, size=4000))  # 7 MB
    kept = [put(fetched / f"kept{at}.mcap", 0, 0o400) for at in range(2)]
    with slow_link(bridge, 1_000_000):  # so slow that it is looked at meanwhile
        pc, _ = two_sides(bridge, bags, own=SMALL)
        name = fetch(pc, "drive.mcap")
        eventually(lambda: "you have kept there, has" in report(pc, name).reason, what="it says so")
        assert report(pc, name).state is FetchState.WAITING
        for each in kept:
            each.unlink()
        done(pc, name)


def test_what_came_live_does_not_count(tmp_path: Path) -> None:
    """A ring may have more than what was fetched: to complete all of it would wait for ever."""
    put(tmp_path / ".one.fetch" / "live" / "0001.mcap", 0)
    put(tmp_path / ".two.fetch" / "live.part" / "0001.mcap", 0)
    kept = put(tmp_path / "own" / "live" / "0001.mcap", 0)
    assert make_room(tmp_path, 0.005) == []
    with pytest.raises(FolderFullError):
        make_room(tmp_path, 0.003)
    assert kept.exists()


def test_what_a_fetch_completes_counts_once_and_stays(tmp_path: Path) -> None:
    named = put(tmp_path / "named.mcap", 0)
    old = put(tmp_path / "old.mcap", 1)
    for name in (".one.fetch", ".two.fetch"):
        (tmp_path / name / "live").mkdir(parents=True)
        (tmp_path / name / "live" / "0001.mcap").hardlink_to(named)
    assert make_room(tmp_path, 0.01) == []
    assert make_room(tmp_path, 0.005) == [old]
    assert named.exists()
