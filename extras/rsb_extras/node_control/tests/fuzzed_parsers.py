"""What a peer says of managed nodes and asks for, and what nodes answer."""

from __future__ import annotations

from contextlib import suppress

from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser
from tests.fuzz.parsers.control_messages import check_message

from rsb_bridge.model.text import is_clean
from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_extras.node_control.cdr_fields import FieldWriter, MalformedAnswerError
from rsb_extras.node_control.change_records import (
    COMPONENT_ACTIONS,
    LIFECYCLE_ACTIONS,
    MOST_COMPONENTS,
    MOST_MANAGED,
    MOST_STEPS,
    TRANSITIONS,
    ChangeText,
    Component,
)
from rsb_extras.node_control.component_messages import read_components, read_load, read_unload
from rsb_extras.node_control.lifecycle_messages import read_offers, read_state, read_success
from rsb_extras.node_control.link_changes import AskManaged, ChangeEnded, ManagedAnswer, RunChange
from rsb_extras.node_control.parameter_messages import (
    names_request,
    read_descriptors,
    read_names,
    read_set,
    read_values,
    set_request,
    write_value,
)
from rsb_extras.node_control.parameter_nodes import is_settable
from rsb_extras.node_control.parameter_records import (
    LARGEST_CHANGE,
    MOST_IN_PAGE,
    MOST_PARAMETERS,
    AskParameters,
    NewValue,
    NodeParameter,
    ParametersAnswer,
    ParameterValue,
)
from rsb_extras.node_control.parameter_rules import about, compare, value_text
from rsb_extras.node_control.tests.scripted_answers import DONE, FAILED, PARAMETER_SIDES, PARAMETERS, SIDES

_MESSAGES = (
    AskManaged(1),
    AskManaged(1, ticket=True),
    ManagedAnswer(1, 2),
    ManagedAnswer(1, 0, SIDES[1].managed),
    RunChange("nav", "up", ticket=2, who="anna on pts/3"),
    RunChange("/nav/planner_server", "configure", ticket=2, again=True),
    ChangeEnded(2, DONE),
    ChangeEnded(2, FAILED),
    RunChange("/nav", "set", ticket=2, values=(NewValue("a.b", ParameterValue.of("double_array", [0.5, 1.0])),)),
    RunChange(
        "/nav",
        "load",
        ticket=2,
        values=(NewValue("a", ParameterValue.of("bool", True)),),
        component=Component("a", "a::B"),
    ),
    RunChange("/nav", "unload", ticket=2, component=Component(name="/a")),
    AskParameters(3),
    AskParameters(3, "/nav", ("frame", "max_speed"), "a", whole=True),
    ParametersAnswer(3, PARAMETERS, more=True),
    ParametersAnswer(3, nodes=PARAMETER_SIDES[1].nodes),
    ParametersAnswer(3, problem="/nav does not run"),
)


def _read_message(data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError:
        return
    if isinstance(message, RunChange):
        assert 0 < len(message.target) <= 255
        assert message.action in (*LIFECYCLE_ACTIONS, *COMPONENT_ACTIONS, "set")
    elif isinstance(message, ManagedAnswer):
        assert len(message.managed.nodes) <= MOST_MANAGED
    elif isinstance(message, ChangeEnded):
        assert len(message.outcome.steps) <= MOST_STEPS
        ChangeText.of("up", message.outcome)
    elif isinstance(message, ParametersAnswer):
        assert len(message.parameters) <= MOST_IN_PAGE
        for each in message.parameters:
            _show(each)
    elif not isinstance(message, AskParameters):
        return
    check_message(message)
    assert decode(encode(message)) == message


def _show(parameter: NodeParameter) -> None:
    """A parameter of a stranger is one line, and its value is what its type says, or none."""
    assert is_clean(value_text(parameter))
    assert len(value_text(parameter)) <= 100
    about(parameter)
    assert is_clean(str(parameter.value))
    with suppress(ValueError):
        assert compare([parameter], {}).equal == 0
        plain = parameter.value.plain()
        if plain is not None and is_settable((NewValue(parameter.name, parameter.value),)):
            set_request((NewValue(parameter.name, parameter.value),))


def _read_parameters(data: bytes) -> None:
    with suppress(MalformedAnswerError):
        names = read_names(data)
        assert all(map(is_clean, names))
        assert len(names) <= MOST_PARAMETERS
    with suppress(MalformedAnswerError):
        for value in read_values(data):
            _show(NodeParameter("a", value))
            assert not value.content or is_settable((NewValue("a", value),)) or len(value.content) > LARGEST_CHANGE
    with suppress(MalformedAnswerError):
        for each in read_descriptors(data):
            assert is_clean(each.description + each.constraints)
            check_message(NodeParameter("a", ranges=each.ranges))
    with suppress(MalformedAnswerError):
        assert is_clean(read_set(data)[1])


def values_answer(*values: ParameterValue) -> bytes:
    """Return an answer of GetParameters: a request of SetParametersAtomically without the names."""
    writer = FieldWriter().number("I", len(values))
    for each in values:
        write_value(writer, each)
    return writer.message


def _descriptors_answer() -> bytes:
    writer = FieldWriter().number("I", 1).text("speed").number("B", 3).text("m/s").text("").number("B", 0)
    writer.number("B", 1).number("I", 1).number("d", 0.0).number("d", 2.0).number("d", 0.1)
    return writer.number("I", 1).number("q", 0).number("q", 10).number("Q", 2).message


def _read_containers(data: bytes) -> None:
    with suppress(MalformedAnswerError):
        components = read_components(data)
        assert len(components) <= MOST_COMPONENTS
        assert all(is_clean(each.name) for each in components)
    for read in (read_load, read_unload):
        with suppress(MalformedAnswerError):
            assert is_clean(read(data).reason + read(data).name)


def _read_answers(data: bytes) -> None:
    with suppress(MalformedAnswerError):
        state = read_state(data)
        assert is_clean(state)
        assert len(state) <= 32
    with suppress(MalformedAnswerError):
        assert {each.transition for each in read_offers(data)} <= {*TRANSITIONS}
    with suppress(MalformedAnswerError):
        read_success(data)


def offers_answer(*offers: tuple[int, str]) -> bytes:
    """Return an answer of GetAvailableTransitions."""
    writer = FieldWriter().number("I", len(offers))
    for number, label in offers:
        writer.number("B", number).text(label)
        writer.number("B", 1).text("unconfigured").number("B", 10).text("configuring")
    return writer.message


PARSERS = (
    Parser("change_message", _read_message, tuple(map(encode, _MESSAGES)), edit_msgpack),
    Parser(
        "lifecycle_answer", _read_answers,
        (
            FieldWriter().number("B", 3).text("active").message,
            offers_answer((1, "configure"), (5, "shutdown")),
            FieldWriter().number("?", True).message,
        ),
    ),
    Parser(
        "container_answer", _read_containers,
        (
            FieldWriter().number("I", 1).text("/a").number("I", 1).number("Q", 1).message,
            FieldWriter().number("?", True).text("").text("/a").number("Q", 1).message,
        ),
    ),
    Parser(
        "parameters_answer", _read_parameters,
        (
            names_request(("a", "b.c")),
            values_answer(*(each.value for each in PARAMETERS[1:])),
            _descriptors_answer(),
            FieldWriter().number("?", False).text("not now").message,
        ),
    ),
)  # fmt: skip
