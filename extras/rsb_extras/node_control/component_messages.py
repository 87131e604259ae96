"""The services of a container of components (composition_interfaces): requests are written here, and answers read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import sanitize_text
from rsb_extras.node_control.cdr_fields import FieldReader, FieldWriter, MalformedAnswerError
from rsb_extras.node_control.change_records import MOST_COMPONENTS
from rsb_extras.node_control.parameter_messages import write_parameters
from rsb_extras.node_control.parameter_records import NewValue, ParameterValue

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_extras.node_control.change_records import Component

LIST, LIST_TYPE = "/_container/list_nodes", "composition_interfaces/srv/ListNodes"
LOAD, LOAD_TYPE = "/_container/load_node", "composition_interfaces/srv/LoadNode"
UNLOAD, UNLOAD_TYPE = "/_container/unload_node", "composition_interfaces/srv/UnloadNode"
_INTRA_PROCESS = NewValue("use_intra_process_comms", ParameterValue.of("bool", True))
"""An argument that rclcpp's containers know."""


class LoadedComponent(NamedTuple):
    """A node in a container, and its number there."""

    name: str
    number: int


class LoadAnswer(NamedTuple):
    """A container's answer to a request to load a component, or to unload one.

    Attributes:
        reason: its own words, if it is not done.
        name: the full name of a node that is loaded.
    """

    done: bool
    reason: str
    name: str = ""


def read_components(answer: bytes) -> list[LoadedComponent]:
    """Return the nodes in an answer of ListNodes; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    names = [sanitize_text(reader.text()) for _ in range(reader.count(5, MOST_COMPONENTS))]
    numbers = reader.numbers("Q", MOST_COMPONENTS)
    if len(numbers) != len(names):
        raise MalformedAnswerError(f"it has {len(names)} names and {len(numbers)} numbers")
    return [LoadedComponent(name, int(number)) for name, number in zip(names, numbers, strict=True)]


def load_request(component: Component, parameters: Sequence[NewValue]) -> bytes:
    """Return a request of LoadNode; raise ValueError if a parameter is none of its type."""
    writer = FieldWriter()
    for text in (component.package, component.plugin, component.name, component.namespace):
        writer.text(text)
    writer.number("B", 0)  # the container's own level of its log
    writer.number("I", len(component.remaps))
    for rule in component.remaps:
        writer.text(rule)
    write_parameters(writer, parameters)
    write_parameters(writer, (_INTRA_PROCESS,) if component.intra_process else ())
    return writer.message


def read_load(answer: bytes) -> LoadAnswer:
    """Return an answer of LoadNode; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    return LoadAnswer(bool(reader.number("B")), sanitize_text(reader.text()), sanitize_text(reader.text()))


def unload_request(number: int) -> bytes:
    """Return a request of UnloadNode."""
    return FieldWriter().number("Q", number).message


def read_unload(answer: bytes) -> LoadAnswer:
    """Return an answer of UnloadNode; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    return LoadAnswer(bool(reader.number("B")), sanitize_text(reader.text()))
