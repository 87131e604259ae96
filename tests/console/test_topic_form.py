"""Topics added, edited and removed by keyboard: picked from both graphs, refused in words, asked about."""

from dataclasses import replace
from typing import Any, get_args

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    choose,
    engine_of,
    fill,
    form_of,
    gone,
    left_as_it_was,
    on_main,
    put,
    shown,
    text,
    told_to_add,
    until,
)
from tests.console.scripted import LINK, SESSION, route
from tests.support.long import long
from textual.pilot import Pilot

from rsb_bridge.config.topic_rules import entry_problems
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Kind, Session, Topic
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.model.transports import Protocol
from rsb_console.app import ConsoleApp
from rsb_console.screens.topic_fields import KINDS, fields_by_kind
from rsb_console.screens.topic_form import TopicScreen
from rsb_console.screens.topic_suggestions import suggestions_for
from rsb_console.session.draft import Ends, problems_of, topic_of, values_of
from rsb_console.widgets.form import Field, FormScreen

SERVER = msgspec.structs.replace(
    SESSION, role="server", clients=(Client("robot1", use_name=True), Client("robot2")), server_ip="0.0.0.0"
)


LINKS: dict[str, dict[str, Any]] = {
    "ip": {"server_ip": "10.0.0.1"},
    "both": {"server_ip": "10.0.0.1", "bluetooth_address": "00:11:22:33:44:55"},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("link", LINKS)
def test_form_offers_transports_that_rules_allow(link: str, kind: Kind) -> None:
    session = msgspec.structs.replace(SESSION, **LINKS[link])
    form = fields_by_kind(session, Ends(is_server=False, client="robot1", use_name=False), None)[kind]
    assert "port" in form
    offered = {value for value, _ in form["protocol"].options if value}
    entries = {each: Topic("/a", "transmit", kind=kind, protocol=each) for each in get_args(Protocol)}
    mistakes = {name: {each.location for each in entry_problems(entry, session)} for name, entry in entries.items()}
    refused = {name for name, places in mistakes.items() if "protocol" in places}
    assert offered == entries.keys() - refused


@pytest.mark.parametrize(
    ("word", "on"), [("true", True), ("yes", True), ("false", False), ("No", False), ("off", False)]
)
def test_switch_is_off_where_word_says_so(word: str, on: bool) -> None:
    topic = topic_of({"topic": "/cmd_vel", "direction": "receive", "arm": word, "paused": word, "lazy": word})
    assert (topic.arm, topic.paused, topic.lazy) == (on, on, on)


@on_main(*long((120, 36)), NARROW)
async def test_topic_is_found_by_letters_with_type(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a", *"dep")
    await shown(pilot, "▌→ /camera/depth")
    await gone(pilot, "not an absolute topic name")  # what is looked for is no mistake
    await pilot.press("down", "enter")  # the second: from the server's graph
    await shown(pilot, "sensor_msgs/msg/Image")
    await shown(pilot, "◉ receive")
    await pilot.press("enter")
    expected = Topic("/camera/depth", "receive", type="sensor_msgs/msg/Image")  # QoS stays auto
    assert await told_to_add(pilot, app) == ("add", expected, "robot1")
    await shown(pilot, "/camera/depth: added")


@on_main()
async def test_each_label_has_room_beside_its_field(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await until(pilot, lambda: isinstance(app.screen, FormScreen), "the form")
    for field in form_of(app).query(Field):
        label = field.query_one(".label")
        await until(pilot, lambda field=field: not field.display or field.size.width > 0, "laid out")
        assert label.styles.width is not None
        assert len(field.spec.label) < label.styles.width.value, field.spec.key


@on_main()
async def test_whole_name_is_taken_despite_longer_offer(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a", *"/camera")
    await shown(pilot, "/camera/depth")
    await pilot.press("enter", "enter")
    assert await told_to_add(pilot, app) == ("add", Topic("/camera", "transmit"), "robot1")


MISTAKES = [
    ("type", "LaserScam", "did you mean sensor_msgs/msg/LaserScan"),
    ("qos", "sensor_date", "did you mean sensor_data?"),
    ("qos", "{depth: 0}", "depth: 0 is out of range"),
    ("qos", "{depth", "is not one of auto"),
    ("port", "70000", "70000 is not a valid port"),
    ("port", "49152", "is the server_port"),
    ("port", "x", "'x' is not"),
    ("remote_topic", "scan", "did you mean /scan?"),
    ("max_rate", "-1", "-1.0 is out of range"),
    ("expected_rate", "fast", "'fast' is not a number"),
    ("stale_after", "inf", "inf is out of range"),
    ("topic", "/1scan", "did you mean /_1scan?"),
]


@pytest.mark.parametrize(("key", "typed", "words"), MISTAKES)
def test_a_mistake_is_named_with_its_field(key: str, typed: str, words: str) -> None:
    found = problems_of(topic_of({"topic": "/scan", "direction": "transmit", key: typed}), SESSION, None)
    assert found.keys() == {key}
    assert words in found[key]


@on_main()
async def test_mistake_is_told_at_its_field(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Texts of an unfolded field, of a folded one, and of the first one."""
    await pilot.press("a")
    await shown(pilot, "Add a topic")
    await fill(pilot, topic="/scan")
    for key, typed, words in (MISTAKES[0], MISTAKES[-2], MISTAKES[-1]):
        field = form_of(app).fields[key]
        await fill(pilot, **{key: typed})
        await until(pilot, lambda f=field, w=words: w in str(f.problem.content), f"{words!r} beneath {key}")
        form_of(app).fields["direction"].control.focus()
        await pilot.press("enter")
        await until(pilot, lambda f=field: f.control.has_focus, f"the focus on {key}")
        assert field.problem.display
        await fill(pilot, **{key: ""})
        await until(pilot, lambda f=field, k=key: k == "topic" or not f.problem.display, f"{key} to be right")
    assert not any(command[0] == "add" for command in engine_of(app).commands)
    await pilot.press("escape")
    await gone(pilot, "Add a topic")


@pytest.mark.parametrize(("qos", "typed"), [(20, "5"), ("sensor_data", "5"), ({"depth": 3}, "{depth: 3}5")])
@on_main()
async def test_qos_policies_extend_but_profiles_replace(
    app: ConsoleApp, pilot: Pilot[None], qos: str | int | dict[str, Any], typed: str
) -> None:
    put(app, route("/scan", spec=Topic("/scan", "receive", qos=qos)))
    await pilot.press("e")
    await shown(pilot, "Edit /scan")
    control = form_of(app).fields["qos"].control
    control.focus()
    await until(pilot, lambda: control.has_focus, "the focus")
    await pilot.press("5")
    assert control.value == typed


@on_main(session=msgspec.structs.replace(SESSION, topics=(Topic("/scan", "transmit"),)))
async def test_topic_that_crosses_already_is_refused_in_form(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "Add a topic")
    await fill(pilot, topic="/scan")
    await pilot.press("enter", "enter")
    await shown(pilot, SessionMistake.TOPIC_TWICE, end="transmit")
    await choose(pilot, "direction", "receive")
    await gone(pilot, SessionMistake.TOPIC_TWICE)


RADIO = msgspec.structs.replace(SESSION, bluetooth_address="B8:27:EB:11:22:33")


@on_main(*long((120, 36)), NARROW, session=RADIO)
async def test_ip_link_with_bluetooth_address_offers_bluetooth(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "Add a topic")
    await fill(pilot, topic="/scan")
    await choose(pilot, "protocol", "bluetooth")
    await pilot.press("enter")
    await shown(pilot, "needs a channel")
    await fill(pilot, port="31")
    await shown(pilot, "31 is not a valid RFCOMM channel")
    await fill(pilot, port="5")
    await pilot.press("enter")
    expected = Topic("/scan", "transmit", protocol="bluetooth", port=5)
    assert await told_to_add(pilot, app) == ("add", expected, "robot1")


@pytest.mark.parametrize("session", [SESSION, RADIO], ids=["no address", "address"])
def test_topic_that_goes_over_bluetooth_can_be_edited(session: Session) -> None:
    edited = Topic("/scan", "receive", protocol="bluetooth", port=5)
    fields = fields_by_kind(
        session, Ends(is_server=False, client="robot1", use_name=False), route("/scan", spec=edited)
    )["topic"]
    assert "bluetooth" in {value for value, _ in fields["protocol"].options}
    assert fields["protocol"].value == "bluetooth"


EDITED = Topic("/scan", "receive", qos={"reliability": "best_effort", "depth": 3}, max_rate=2.5, port=5000)


@on_main(landmark="/scan", routes=(route("/scan", spec=EDITED),))
async def test_fields_are_found_by_their_names(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("e")
    await until(pilot, lambda: isinstance(app.screen, TopicScreen), "the form")
    fields = form_of(app).fields
    await until(pilot, lambda: fields["max_rate"].control.has_focus, "the likeliest field is the first")
    await pilot.press("f7", *"pri")
    await until(pilot, lambda: fields["priority"].control.has_focus, "one name begins so")
    await pilot.press("f7", "p")
    await shown(pilot, "Port, Priority, Paused")
    await pilot.press("z", "escape")
    await until(pilot, lambda: fields["priority"].control.has_focus, "back")
    await pilot.press("f7", "m", "enter")
    await until(pilot, lambda: fields["max_rate"].control.has_focus, "the first of several")
    assert fields["max_rate"].value == "2.5"


@on_main(landmark="/scan", routes=(route("/scan", spec=EDITED),))
async def test_edit_begins_with_present_and_sends_new(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("e")
    await shown(pilot, "{reliability: best_effort, depth: 3}")
    await left_as_it_was(app, pilot, "/scan")
    await fill(pilot, max_rate="5")
    await choose(pilot, "compression", "zstd")
    await pilot.press("enter")
    await until(pilot, lambda: engine_of(app).commands, "the command")
    became = msgspec.structs.replace(EDITED, max_rate=5, compression="zstd")
    assert engine_of(app).commands == [("edit", "/scan", became)]


@on_main()
async def test_removing_asks_with_the_focus_on_no(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("d", "enter")
    await gone(pilot, "Remove /robot2/scan?")
    await pilot.press("d", "escape")
    await gone(pilot, "Remove /robot2/scan?")
    assert engine_of(app).commands == []
    await pilot.press("d", "y")
    await until(pilot, lambda: engine_of(app).commands, "the command")
    assert engine_of(app).commands == [("remove", "/robot2/scan")]


@on_main(session=SERVER)
async def test_on_a_server_the_form_asks_which_client(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=tuple(replace(LINK, name=name) for name in ("robot1", "robot2")))
    await pilot.press("a")
    await shown(pilot, "◉ robot1   ○ robot2")
    await shown(pilot, "transmit ←")
    await choose(pilot, "link", "robot2")
    await until(pilot, lambda: ("topics", "robot2") in engine_of(app).commands, "a look at robot2's graph")
    await fill(pilot, topic="/scan")
    await pilot.press("enter", "enter")
    assert await told_to_add(pilot, app) == ("add", Topic("/scan", "transmit"), "robot2")


@on_main()
async def test_a_restart_asks_then_shows_its_steps(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("R", "enter")
    await gone(pilot, "Restart the bridge?")
    assert engine_of(app).commands == []
    await pilot.press("R", "y")
    for words in ("telling the peer", "sockets closed", "✓ restarted"):
        await shown(pilot, words)
    assert text(app).index("telling the peer") < text(app).index("sockets closed") < text(app).index("restarted")
    await pilot.press("enter")
    await gone(pilot, "✓ restarted")


# -- the texts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "topic",
    [
        Topic("/scan", "receive"),
        Topic("/scan", "transmit", "LaserScan", "udp", 5000, "latched", "/there", "zstd", 5.0, 10.0, 0.0, paused=True),
        Topic("/scan", "transmit", qos=20, max_rate=0.25),
        Topic("/scan", "transmit", qos={"profile": "sensor_data", "depth": 20, "deadline": 0.5}),
        Topic("/cmd_vel", "receive", stale_after=3.0, arm=True, deadman=20.0),
        Topic("/image", "transmit", lazy=False, renew=True, beat="front"),
    ],
)
def test_a_topic_survives_the_form(topic: Topic) -> None:
    assert topic_of(values_of(topic)) == topic


def info(topic: str, publishers: int = 1, subscriptions: int = 0) -> TopicInfo:
    return TopicInfo(topic, "std_msgs/msg/String", "", Qos() if publishers else None, publishers, subscriptions)


@pytest.mark.parametrize("is_server", [False, True])
def test_topics_flow_from_publishers_to_where_somebody_listens(is_server: bool) -> None:
    here, there = [info("/a"), info("/b", 0, 1)], [info("/c"), info("/d", 0, 2)]
    suggestions = suggestions_for(Ends(is_server, "robot1", use_name=False), here, there, bridged=[])
    ways = {suggestion.value: suggestion.fills["direction"] for suggestion in suggestions}
    to_there, to_here = ("receive", "transmit") if is_server else ("transmit", "receive")
    assert ways == {"/a": to_there, "/b": to_here, "/c": to_here, "/d": to_there}


@pytest.mark.parametrize("publisher_here", [True, False])
def test_topic_with_both_ends_is_told_by_publisher(publisher_here: bool) -> None:
    here, there = [info("/a")], [info("/a", 0, 1)]
    if not publisher_here:
        here, there = there, here
    (offer,) = suggestions_for(Ends(False, "robot1", False), here, there, [])
    assert f"1 publisher {'here' if publisher_here else 'there'}" in "".join(piece for piece, _ in offer.line(80))
    assert offer.fills["direction"] == ("transmit" if publisher_here else "receive")


def test_bridged_topics_are_not_offered_again() -> None:
    crossing = route("/a", spec=Topic("/a", "transmit", remote_topic="/b"), remote_topic="/b", outgoing=True)
    ends = Ends(is_server=False, client="robot1", use_name=False)
    here, there = [info("/a"), info("/c")], [info("/b", 0, 1), info("/d", 0, 1)]
    assert [suggestion.value for suggestion in suggestions_for(ends, here, there, [crossing])] == ["/c", "/d"]
    back = suggestions_for(ends, [], [info("/b")], [crossing])
    assert [(suggestion.value, suggestion.fills["direction"]) for suggestion in back] == [("/b", "receive")], (
        "another's publisher"
    )


@pytest.mark.parametrize("width", [73, 78, 93])
def test_types_get_the_room_that_names_leave(width: int) -> None:
    battery = TopicInfo("/battery_state", "sensor_msgs/msg/BatteryState", "", Qos(), 1, 0)
    (suggestion,) = suggestions_for(Ends(False, "robot1", False), [], [battery], [])
    line = "".join(piece for piece, _ in suggestion.line(width))
    assert line.endswith("  sensor_msgs/BatteryState")
    assert len(line) <= width


def test_a_type_that_is_cut_shows_that() -> None:
    pose = TopicInfo("/initial_pose_of_robot", "geometry_msgs/msg/PoseWithCovarianceStamped", "", Qos(), 1, 0)
    (suggestion,) = suggestions_for(Ends(False, "robot1", False), [], [pose], [])
    line = "".join(piece for piece, _ in suggestion.line(73))
    assert len(line) <= 73
    assert "geometry_msgs" in line
    assert "…" in line
    assert line.endswith("Stamped")


@pytest.mark.parametrize("width", [73, 93])
def test_a_long_name_is_cut_in_its_middle(width: int) -> None:
    (suggestion,) = suggestions_for(
        Ends(False, "robot1", False), [info("/camera/front/left/depth/image_rect_raw/compressed")], [], []
    )
    line = "".join(piece for piece, _ in suggestion.line(width))
    assert "/camera/front" in line
    assert "compressed " in line
    assert len(line) <= width


def test_the_servers_names_lose_the_clients_prefix() -> None:
    there = [info("/robot1/map"), info("/robot2/map"), info("/map")]
    suggestions = suggestions_for(Ends(False, "robot1", use_name=True), [], there, [])
    assert [(suggestion.value, suggestion.fills["direction"]) for suggestion in suggestions] == [("/map", "receive")]
