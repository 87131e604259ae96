"""Calling a service by hand, sending a goal and setting a parameter, on an engine that plays a script."""

from typing import Any

import pytest
from rich.cells import cell_len
from tests.console.driving import (
    NARROW,
    WIDE,
    Decorator,
    choose,
    engine_of,
    fill,
    form_of,
    gone,
    notices,
    on_main,
    put,
    settled,
    shown,
    text,
    until,
)
from tests.console.scripted import CALL_ROUTES, ROUTES, ScriptedEngine, call_route
from tests.support.long import long
from tests.support.wording import pattern, says
from textual.pilot import Pilot
from textual.widgets import Button

from rsb_bridge.api import EngineError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.snapshot import State
from rsb_console.actions.all_actions import BY_ID
from rsb_console.app import ConsoleApp
from rsb_console.notation.formats import AnswerText, RowText
from rsb_console.screens.by_hand_screen import FieldsText
from rsb_console.screens.call_screen import CallText, answer_lines
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.session.parameter_values import KIND_NAMES, ValueText, refusal, set_request
from rsb_console.widgets.lines import ScrolledLines

MODE, MAP, NAVIGATE, PARAMETERS = CALL_ROUTES
TEMPLATES = {"": "data: false\n", "send_goal": "pose:\n  x: 0.0\n", "get_parameters": "names: []\n"}


def on(route: Any, *sizes: Any, **options: Any) -> Decorator:
    """A test's steps run with one thing bridged, whose requests' fields are known."""

    def make(session: Any, base: Any) -> ScriptedEngine:
        engine = ScriptedEngine(session, base, (route,))
        engine.templates = dict(TEMPLATES)
        return engine

    return on_main(*sizes, landmark=route.topic, make_engine=make, **options)


def calls(app: ConsoleApp) -> list[tuple[object, ...]]:
    return [command for command in engine_of(app).commands if command[0] == "call"]


async def call(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("C")
    await shown(pilot, "data: false")
    await pilot.press("f9", "y")
    await until(pilot, lambda: calls(app), "the call")


@on(MODE, *long(WIDE), NARROW)
async def test_confirmed_call_is_sent_once_and_answered(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("C")
    await shown(pilot, "data: false")
    await shown(pilot, CallText.NOTHING_CALLED)
    await fill(pilot, request="data: true")
    await pilot.press("f9")
    await shown(pilot, "Call /robot1/set_mode?")
    await until(pilot, lambda: app.focused is app.screen.query_one("#no", Button), "No is what enter gives")
    await shown(pilot, CallText.REQUEST_SENT, where="to the node behind 10.0.0.20:49152")
    await gone(pilot, "scroll")
    await pilot.press("enter")
    await gone(pilot, "Call /robot1/set_mode?")
    await shown(pilot, CallText.NOTHING_CALLED)
    assert calls(app) == []
    await pilot.press("f9")
    await shown(pilot, ConfirmScreen.KEYS)
    await pilot.press("y")
    await until(pilot, lambda: calls(app) == [("call", MODE.key, "data: true", "")], "the call")
    await shown(pilot, CallText.WAITING_UNTIL, sign="▸", limit=30)
    engine_of(app).called.set_result("success: true\nmessage: moved\n")
    await shown(pilot, "message: moved")
    await shown(pilot, AnswerText.ANSWERED, link="robot1", nodes="a node", where="there")
    await gone(pilot, CallText.WAITING)


@on(MODE)
async def test_missing_answer_is_explained_with_retry(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await call(app, pilot)
    engine_of(app).called.set_exception(EngineError("no luck\x1b[2J"))
    await shown(pilot, "✗ no luck")
    await settled(pilot)
    assert all(line.isprintable() for line in text(app).split("\n"))
    await pilot.press("f9", "y")
    await until(pilot, lambda: len(calls(app)) == 2, "another call")


@on(MODE)
async def test_running_call_is_not_repeated_keys_work(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await call(app, pilot)
    put(app, call_route("service", "/robot1/set_mode", State.DOWN, reason="no server any more"))
    await shown(pilot, "✗ DOWN  std_srvs/srv/SetBool  no server any more")
    await pilot.press("f9")
    await until(pilot, lambda: notices(app), "why not")
    assert len(calls(app)) == 1
    await pilot.press("escape")
    await gone(pilot, CallText.WAITING)
    assert engine_of(app).called.cancelled(), "nobody waits any more"
    put(app, *ROUTES)
    await shown(pilot, "/robot1/scan")


@on(MODE)
async def test_invalid_request_is_told_while_typing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("C")
    await shown(pilot, "data: false")
    for wrong, words in (
        ("- 1\n- 2", FieldsText.NO_MAPPING),
        ("data: [", "while parsing"),
        ("a: &x 1\nb: *x", "alias"),
    ):
        await fill(pilot, request=wrong)
        await shown(pilot, words)
        await pilot.press("f9")
        await settled(pilot)
        await gone(pilot, "Call /robot1/set_mode?")
    await fill(pilot, request="")
    await gone(pilot, "aliases")
    await pilot.press("f9")
    await shown(pilot, FieldsText.ALL_DEFAULTS)
    await pilot.press("y")
    await until(pilot, lambda: calls(app) == [("call", MODE.key, "", "")], "an empty request")


@on(call_route("service", "/unknown"))
async def test_untyped_form_explains_and_is_filled(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).templates = {}
    await pilot.press("C")
    await shown(pilot, "std_srvs is not installed")
    await fill(pilot, request="data: true")
    await pilot.press("f9", "y")
    await until(pilot, lambda: calls(app), "the call")


@on(NAVIGATE)
async def test_of_an_action_each_service_can_be_called(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("C")
    for service in ("◉ send_goal", "○ cancel_goal", "○ get_result"):
        await shown(pilot, service)
    await shown(pilot, "pose:")
    await choose(pilot, "lane", "cancel_goal")
    await gone(pilot, "pose:")
    await fill(pilot, request="goal_info: {}")
    await pilot.press("f9")
    await shown(pilot, "Call cancel_goal of /navigate_to_pose?")
    await pilot.press("y")
    await until(pilot, lambda: calls(app) == [("call", NAVIGATE.key, "goal_info: {}", "cancel_goal")], "the call")
    await shown(pilot, CallText.WAITING)
    await gone(pilot, CallText.WAITING_UNTIL)  # a result may take as long as it likes


@on(PARAMETERS, *long(WIDE), NARROW)
async def test_parameter_is_set_by_its_name_and_value(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("C")
    await shown(pilot, "set one parameter")
    await pilot.press("f9")
    await shown(pilot, CallText.NAME_MISSING)
    await shown(pilot, "missing: 5, 5.0, true")
    await fill(pilot, name="max_vel_x", value="0.5")
    await pilot.press("enter")
    await shown(pilot, "Set max_vel_x of /controller_server?")
    await shown(pilot, "0.5 (double)")
    await pilot.press("y")
    await until(pilot, lambda: calls(app), "the call")
    _, key, request, lane = calls(app)[0]
    assert (key, lane) == (PARAMETERS.key, "set_parameters")
    assert read_fields(str(request)) == {
        "parameters": [{"name": "max_vel_x", "value": {"type": "3", "double_value": "0.5"}}]
    }
    engine_of(app).called.set_result("results:\n- successful: true\n  reason: ''\n")
    await shown(pilot, CallText.VALUE_SET)


@on(MODE, NARROW)
async def test_long_answer_scrolls_and_is_laid_out_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await call(app, pilot)
    answer = f"first: {'x' * 1000}\n" + "".join(f"line_{number}: {number}\n" for number in range(10_000))
    engine_of(app).called.set_result(answer)
    await shown(pilot, "first: xxx")
    pane = app.screen.query_one("#answer", ScrolledLines)
    await pilot.press("G")
    await shown(pilot, "only the first 2 000 lines are shown")
    await shown(pilot, "line_198")
    await settled(pilot)
    first, at = pane.line(0), pane.scroll_offset
    put(app, call_route("service", "/robot1/set_mode", State.DOWN, reason="no server any more"))
    await shown(pilot, "no server any more")  # drawn by the timer
    assert pane.line(0) is first
    assert pane.scroll_offset == at
    app.clear_notifications()
    await pilot.press("y")
    await until(pilot, lambda: app.clipboard == answer and notices(app), "all of it, copied")
    assert max(len(each.message) for each in notices(app)) < 300
    await pilot.resize_terminal(70, 36)
    await until(pilot, lambda: pane.line(0) is not first, "laid out for the new width")


@pytest.mark.parametrize(
    ("request_", "last"),
    [
        ("data: " + "long " * 600 + "last", "last"),
        ("\n".join(f"line_{number}: {number}" for number in range(100)), "line_99: 99"),
        ("data:" + " long" * 2000, "characters more)"),
    ],
    ids=["a long line", "many lines", "too much"],
)
@on(MODE, *long((120, 36), NARROW), (80, 12))
async def test_buttons_stay_in_sight_below_long_request(
    app: ConsoleApp, pilot: Pilot[None], request_: str, last: str
) -> None:
    await pilot.press("C")
    await until(pilot, lambda: form_of(app).values["request"], "the template")
    await fill(pilot, request=request_)
    await pilot.press("f9")
    await shown(pilot, "Call        No")
    await shown(pilot, "↑ ↓ scroll")
    await gone(pilot, last)
    await pilot.press("G")
    await shown(pilot, last)
    await shown(pilot, "Call        No")
    assert calls(app) == []
    await pilot.press("y")
    await until(pilot, lambda: calls(app) == [("call", MODE.key, request_, "")], "all of it")


def test_wide_characters_are_wrapped_by_width() -> None:
    lines = ["".join(piece for piece, _ in line) for line in answer_lines("a: " + "地図" * 20, 21)]
    assert "".join(lines) == "a: " + "地図" * 20
    assert all(cell_len(line) <= 21 for line in lines)


def test_answers_are_wrapped_and_harmless() -> None:
    lines = [
        "".join(piece for piece, _ in line) for line in answer_lines("a: '" + "x" * 30 + "\x1b[2J\u202e'\n# cut", 20)
    ]
    assert lines[0] == "a: 'xxxxxxxxxxxxxxxx"
    assert all(len(line) <= 20 and line.isprintable() for line in lines)
    assert lines[-1] == "# cut"
    assert list(answer_lines("", 20)) == []


@on_main(routes=(*ROUTES, MODE))
async def test_call_key_is_shown_only_where_callable(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "q quit")
    await gone(pilot, "C call")
    await pilot.press("C")
    await settled(pilot)
    assert app.screen is app.main
    await pilot.press("slash", *"set_mode", "enter")
    await shown(pilot, "C call")
    assert BY_ID["call"].changes
    await pilot.press("question_mark")
    await shown(pilot, BY_ID["move_down"].help)
    await pilot.press("pagedown")
    await shown(pilot, BY_ID["call"].help)


@on(MODE)
async def test_a_service_has_no_message_to_look_at(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for keys in (["v"], ["enter", "enter"]):
        await pilot.press(*keys)
        await until(pilot, lambda: notices(app), "what it has instead")
        assert app.screen is app.main
        assert any(says(each.message, RowText.NO_MESSAGES_BUT_CALLS, key="C") for each in notices(app))
        app.clear_notifications()
    assert not any(command[0] == "peek" for command in engine_of(app).commands)


# -- values of parameters --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "type_number", "field", "made", "words"),
    [
        ("true", "1", "bool_value", "true", "(bool)"),
        ("-5", "2", "integer_value", "-5", "(integer)"),
        ("5.0", "3", "double_value", "5.0", "(double)"),
        ("1e3", "3", "double_value", "1000.0", "(double)"),
        ("-.inf", "3", "double_value", "-.inf", "(double)"),
        ("map", "4", "string_value", "map", "(string)"),
        ("'5'", "4", "string_value", "5", "(string)"),
        ("''", "4", "string_value", "", "(string)"),
        ("a b", "4", "string_value", "a b", "(string)"),
        ("no", "4", "string_value", "no", "(string)"),
        ("[1, 2]", "7", "integer_array_value", ["1", "2"], "(array of integers)"),
        ("[1, 2.5]", "8", "double_array_value", ["1.0", "2.5"], "(array of doubles)"),
        ("[a, '1']", "9", "string_array_value", ["a", "1"], "(array of strings)"),
        ("[true]", "6", "bool_array_value", ["true"], "(array of bools)"),
        ("9223372036854775807", "2", "integer_value", "9223372036854775807", "(integer)"),
        ("-9223372036854775808", "2", "integer_value", "-9223372036854775808", "(integer)"),
        ("0x1F", "2", "integer_value", "31", "(integer)"),
        ("1e400", "3", "double_value", ".inf", "(double)"),
        (".nan", "3", "double_value", ".nan", "(double)"),
        ("[.inf, -.inf, 1]", "8", "double_array_value", [".inf", "-.inf", "1.0"], "(array of doubles)"),
        ("'true'", "4", "string_value", "true", "(string)"),
        ("yes", "4", "string_value", "yes", "(string)"),
        ("inf", "4", "string_value", "inf", "(string)"),
        ("['true', 'null']", "9", "string_array_value", ["true", "null"], "(array of strings)"),
    ],
)
def test_the_value_says_its_type(value: str, type_number: str, field: str, made: object, words: str) -> None:
    request = set_request("p", value)
    assert read_fields(request.text) == {"parameters": [{"name": "p", "value": {"type": type_number, field: made}}]}
    assert request.meaning.endswith(words)


@pytest.mark.parametrize(
    ("value", "kind", "field", "made"),
    [
        ("5", "string", "string_value", "5"),
        ("true", "string", "string_value", "true"),
        ("5", "double", "double_value", "5.0"),
        ("[1, 2]", "double_array", "double_array_value", ["1.0", "2.0"]),
        ("[0, 255]", "byte_array", "byte_array_value", ["0", "255"]),
        *(
            ("[]", f"{each}_array", f"{each}_array_value", [])
            for each in ("byte", "bool", "integer", "double", "string")
        ),
    ],
)
def test_a_type_that_is_asked_for_is_had(value: str, kind: str, field: str, made: object) -> None:
    wanted = {"type": str(KIND_NAMES.index(kind) + 1), field: made}
    assert read_fields(set_request("p", value, kind).text) == {"parameters": [{"name": "p", "value": wanted}]}


@pytest.mark.parametrize(
    ("value", "kind"),
    [("fast", "double"), ("5.0", "integer"), ("1", "bool"), ("[256]", "byte_array"), ("[true]", "byte_array"),
     ("5", "integer_array"), ("[5]", "integer"), ("[1]", "string_array")],
)  # fmt: skip
def test_value_of_wrong_type_is_refused(value: str, kind: str) -> None:
    with pytest.raises(FieldError):
        set_request("p", value, kind)


@pytest.mark.parametrize(
    "value", ["9223372036854775808", "-9223372036854775809", "9" * 5000, "[1, 0xffffffffffffffff]"]
)
def test_integer_beyond_64_bits_names_parameter(value: str) -> None:
    with pytest.raises(FieldError, match="^max_rate: " + pattern(ValueText.NO_INTEGER, bits=64)):
        set_request("max_rate", value)


@pytest.mark.parametrize("value", ["", "# nothing", "[]", "[[1]]", "[1, a]", "{a: 1}", "[1", "a: b: c", "null", "~"])
def test_what_is_no_value_is_refused_in_words(value: str) -> None:
    with pytest.raises(FieldError):
        set_request("p", value)


def test_a_long_value_is_shown_by_its_beginning() -> None:
    assert set_request("p", "x" * 500).meaning == f"{'x' * 60}… (string)"


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ("results:\n- successful: true\n  reason: ''\n", None),
        ("results:\n- successful: false\n  reason: too fast\n", "too fast"),
        ("results:\n- successful: false\n  reason: ''\n", ValueText.NO_REASON()),
        ("results:\n- successful: true\n- 1\n", ValueText.NO_REASON()),
        ("results: []\n", ValueText.NO_RESULT()),
        ("- 1\n", ValueText.NO_RESULT()),
        ("[", ValueText.NO_RESULT()),
    ],
)
def test_what_the_node_says_to_a_value(answer: str, why: str | None) -> None:
    assert refusal(answer) == why
