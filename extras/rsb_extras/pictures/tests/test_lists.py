"""Frames, diagnostics, logs and tracks."""

from __future__ import annotations

import itertools
from typing import Any

import msgspec
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log
from sensor_msgs.msg import NavSatFix
from tests.support.wording import has_text

from rsb_bridge.cdr.decoder import Items
from rsb_extras.pictures.drawing import Drawn, TakenMessage
from rsb_extras.pictures.lists import TfTree, TreeProblem
from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.tests.samples import cells_of, drawn, task
from rsb_extras.pictures.track import TrackProblem
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=80, height=20)


def rows(picture: Picture | Drawn) -> list[str]:
    return [row.rstrip() for row in cells_of(picture).rows]


def transforms(*pairs: tuple[str, str], at: float = 0.0, topic: str = "/tf", author: str = "") -> TakenMessage:
    """Return a TFMessage as it is decoded; its package is not among the test's."""
    shown: list[Any] = [
        {"header": {"frame_id": parent}, "child_frame_id": child, "transform": {}} for parent, child in pairs
    ]
    items = Items("geometry_msgs/msg/TransformStamped", len(shown), shown)
    return TakenMessage(topic, "tf2_msgs/msg/TFMessage", {"transforms": items}, at, author)


def tree(*received: TakenMessage) -> tuple[list[str], str]:
    view = TfTree()
    for each in received:
        view.receive(each)
    result = view.draw(WISH)
    return rows(result), result.problem


def test_frames_are_below_their_parents() -> None:
    lines, problem = tree(transforms(("map", "odom"), ("odom", "base")))
    assert [line.split()[0] for line in lines] == ["map", "odom", "base"]
    assert [len(line) - len(line.lstrip()) for line in lines] == [0, 2, 4]
    assert problem == ""


def test_ages_rates_and_static_frames() -> None:
    moving = [transforms(("map", "odom"), at=at / 10) for at in range(11)]
    lines, _ = tree(transforms(("odom", "laser"), topic="/tf_static"), *moving, transforms(("odom", "wheel"), at=5.0))
    assert any("odom" in line and "10 Hz" in line and "4.0 s" in line for line in lines)
    assert any("laser" in line and "static" in line for line in lines)


def test_what_is_wrong_with_frames() -> None:
    lines, problem = tree(transforms(("map", "base"), ("odom", "base"), ("x", "y"), ("y", "x")))
    assert has_text(problem, TreeProblem.ROOTS)
    assert any(has_text(line, TreeProblem.TWO_PARENTS) for line in lines)
    assert sum(has_text(line, TreeProblem.CIRCLE) for line in lines) == 2


def test_who_publishes_frames() -> None:
    lines, _ = tree(
        transforms(("map", "odom"), author="/ekf"),
        transforms(("odom", "base"), author="/ekf"),
        transforms(("odom", "base"), author="/wheels"),
        transforms(("base", "laser"), author="/old"),
        transforms(("base", "laser"), at=5.0, author="/new"),
        transforms(("map", "odom"), at=5.0, author="/ekf"),
        transforms(("odom", "base"), at=5.0, author="/ekf"),
        transforms(("odom", "base"), at=5.0, author="/wheels"),
    )
    assert has_text(lines[1], TreeProblem.AUTHOR, author="/ekf")
    assert has_text(lines[2], TreeProblem.TWO_AUTHORS, authors="/ekf, /wheels")
    assert has_text(lines[3], TreeProblem.AUTHOR, author="/new")


def test_a_long_chain_is_no_circle() -> None:
    lines, problem = tree(transforms(*[(f"f{at}", f"f{at + 1}") for at in range(500)]))
    assert problem == ""
    assert not any(has_text(line, TreeProblem.CIRCLE) for line in lines)


def test_the_worst_diagnostics_come_first_with_their_values() -> None:
    fine = DiagnosticStatus(level=b"\x00", name="fine", values=[KeyValue(key="k", value="hidden")])
    bad = DiagnosticStatus(level=b"\x02", name="bad", message="hot", values=[KeyValue(key="temperature", value="99")])
    lines = rows(drawn(WISH, DiagnosticArray(status=[fine, bad])))
    assert "bad" in lines[0]
    assert "99" in lines[1]
    assert "fine" in lines[2]
    assert not any("hidden" in line for line in lines)


AGGREGATED = (
    ("/Robot", 2), ("/Robot/Motors", 2), ("/Robot/Motors/left", 2), ("/Robot/Motors/right", 0), ("/Robot/Power", 0),
    ("/Robot/Power/battery", 0), ("node: a/b", 0),
)  # fmt: skip


def diagnostics(*names: tuple[str, int], wish: Wish = WISH) -> list[str]:
    values = [KeyValue(key="current", value="9 A")]
    statuses = [DiagnosticStatus(level=bytes((level,)), name=name, values=values) for name, level in names]
    return rows(drawn(wish, DiagnosticArray(status=statuses)))


def test_aggregated_diagnostics_are_a_tree() -> None:
    lines = diagnostics(*AGGREGATED, wish=Wish(width=80, height=7))
    found = [line for line in lines if "current" not in line]
    assert [line.split()[-1] for line in found] == ["Robot", "Motors", "left", "right", "Power", "a/b"]
    assert [line[:6].strip() for line in found] == ["ERROR", "ERROR", "ERROR", "ok", "ok", "ok"]
    assert "1 in Power" in found[4], "there is nothing wrong with what it has"
    assert len(lines) - len(found) == 1, "values of what is bad itself"


def test_groups_without_faults_are_opened_if_there_is_room() -> None:
    assert any("battery" in line for line in diagnostics(*AGGREGATED))
    assert not any("battery" in line for line in diagnostics(*AGGREGATED, wish=Wish(width=80, height=7)))


def test_group_is_as_bad_as_its_worst() -> None:
    lines = diagnostics(("/a/b/c", 0), ("/a/b/d", 1), ("/a/e", 0))
    assert [line[:6].strip() for line in lines if "current" not in line] == ["WARN", "WARN", "WARN", "ok", "ok"]


def test_found_diagnostics_have_their_groups() -> None:
    lines = diagnostics(*AGGREGATED, wish=Wish(width=80, height=20, match="battery"))
    assert [line.split()[-1] for line in lines] == ["Robot", "Power", "battery"]


def test_deep_names_end_in_one_group() -> None:
    assert len(diagnostics(("/".join(["", *"abcdefghijklm"]), 0))) == 8


def test_stale_diagnostics() -> None:
    old, new = (DiagnosticArray(status=[DiagnosticStatus(name=name)]) for name in ("old", "new"))
    picture = Artist().do(task(WISH, old, new, every=60.0))
    assert picture is not None
    assert "old" in rows(picture)[0]
    assert "STALE" in rows(picture)[0]


def test_log_lines_by_level_repeated_are_counted() -> None:
    lines = [Log(level=20, name="a", msg="started"), *[Log(level=40, name="b", msg="broken\nagain")] * 3]
    shown = rows(drawn(WISH, *lines))
    assert len(shown) == 2
    assert "×3" in shown[1]
    assert len(rows(drawn(Wish(level=30), *lines))) == 1
    assert "started" in rows(drawn(Wish(match="start"), *lines))[0]


def test_a_track() -> None:
    fixes = [NavSatFix(latitude=48.0 + at * 1e-5, longitude=11.0) for at in range(20)]
    lines = rows(drawn(WISH, *fixes))
    assert any("◆" in line for line in lines)
    assert any("m" in line for line in lines)


def fixes(deviation: float = 0.0) -> list[NavSatFix]:
    """Return fixes on a way to the north, of 1.11 m each 0.1 s."""
    covariance = [deviation**2, 0.0, 0.0, 0.0, deviation**2, 0.0, 0.0, 0.0, 0.0]
    return [
        NavSatFix(
            latitude=48.0 + at * 1e-5, longitude=11.0, position_covariance=covariance,
            position_covariance_type=2 if deviation else 0,
        )
        for at in range(20)
    ]  # fmt: skip


def test_a_track_has_speed_and_deviation() -> None:
    exact, rough = (drawn(WISH, *fixes(deviation)) for deviation in (0.0, 5.0))
    assert any("11.1 m/s" in note for note in exact.notes)
    assert any("± 5 m" in note for note in rough.notes)
    assert not any("±" in note for note in exact.notes)
    dim = [cells_of(each).styles.count(cells_of(each).palette.index("dim")) for each in (rough,)]
    assert dim[0] > 8
    assert "dim" not in cells_of(exact).palette


def test_no_fix() -> None:
    message = NavSatFix()
    message.status.status = -1
    assert has_text(drawn(WISH, message).problem, TrackProblem.NO_FIX)


def test_frames_are_drawn_below_one_parent() -> None:
    layers = [[f"f{depth}_{at}" for at in range(8)] for depth in range(20)]
    pairs = [(one, other) for above, below in itertools.pairwise(layers) for one in above for other in below]
    view = TfTree()
    view.receive(transforms(*pairs))
    picture = view.draw(Wish(width=80, height=100))
    assert picture.notes == ("160 frames",)
    assert len(rows(picture)) == 100


def test_ages_of_frames_go_on_without_messages() -> None:
    view = TfTree()
    view.receive(transforms(("odom", "base"), at=1.0))
    fresh = view.draw(WISH)
    view.now = 4.5
    old = view.draw(WISH)
    assert "0.0 s" in rows(fresh)[1]
    assert "3.5 s" in rows(old)[1]
    assert "warning" in {cells_of(old).palette[style] for style in cells_of(old).styles}


def test_statuses_become_stale_without_messages() -> None:
    message = DiagnosticArray(status=[DiagnosticStatus(level=b"\0", name="motor")])
    artist, first = Artist(), task(WISH, message, at=1000.0)
    before = artist.do(msgspec.structs.replace(first, now=1001 * 10**9))
    after = artist.do(msgspec.structs.replace(first, samples=(), now=1009 * 10**9))
    assert before is not None
    assert after is not None
    assert before.notes != after.notes
    assert rows(after)[0].startswith("STALE")
