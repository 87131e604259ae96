"""The parameters of this side's nodes: which nodes have some, a page of one node's, and a change of some."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import msgspec

from rsb_bridge.feature_api import LinkError, join_first, sanitize_text
from rsb_extras.node_control.cdr_fields import MalformedAnswerError
from rsb_extras.node_control.change_records import ChangeStep
from rsb_extras.node_control.node_services import NodeSilentError, both, nodes_serving
from rsb_extras.node_control.parameter_messages import (
    ALL_NAMES,
    DESCRIBE,
    DESCRIBE_TYPE,
    GET,
    GET_TYPE,
    LIST,
    LIST_TYPE,
    NO_DESCRIPTOR,
    SET,
    SET_TYPE,
    names_request,
    read_descriptors,
    read_names,
    read_set,
    read_values,
    set_request,
)
from rsb_extras.node_control.parameter_records import (
    LARGEST_CHANGE,
    LARGEST_VALUE,
    MOST_IN_PAGE,
    MOST_NAMED,
    MOST_NODES,
    MOST_PARAMETERS,
    MOST_SET,
    SHOWN_VALUE,
    AskParameters,
    NodeParameter,
    ParametersAnswer,
    ParametersProblem,
    ParameterValue,
)

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from rsb_bridge.feature_api import Context
    from rsb_extras.node_control.node_services import NodeServices
    from rsb_extras.node_control.parameter_messages import ReadDescriptor
    from rsb_extras.node_control.parameter_records import NewValue

T = TypeVar("T")

_READ_WITHIN = 3.0
_SET_WITHIN = 20.0  # s. Round figures: a node may take on its parameters in a callback
_PAGE = 32 << 10
"""Bytes of values and texts in a page, if it has more than one parameter: a thin link has other news, too."""
_NAMED = 3  # names of parameters in a line


async def nodes_with_parameters(context: Context) -> tuple[str, ...]:
    """Return the names of nodes with parameters, sorted."""
    return await nodes_serving(context, LIST, LIST_TYPE, MOST_NODES)


async def page_of(services: NodeServices, ask: AskParameters) -> ParametersAnswer:
    """Return a page of a node's parameters, with a problem if it does not give them."""
    node = ask.node
    try:
        all_names = read_names(await services.call(node, LIST, LIST_TYPE, ALL_NAMES, _READ_WITHIN))
        names = [each for each in all_names if each > ask.after and (not ask.names or each in ask.names)]
        described, values = await both(
            _of_each(services, node, names[:MOST_IN_PAGE], DESCRIBE, DESCRIBE_TYPE, read_descriptors),
            _of_each(services, node, names[:MOST_IN_PAGE], GET, GET_TYPE, read_values),
        )
    except NodeSilentError as error:
        return ParametersAnswer(ask.request, problem=sanitize_text(str(error)))
    except MalformedAnswerError as error:
        return ParametersAnswer(ask.request, problem=ParametersProblem.NO_ANSWER(node=node, error=error))
    page: list[NodeParameter] = []
    size = 0
    for name, descriptor, value in zip(names, described, values, strict=False):
        parameter = _parameter(name, descriptor, value, whole=ask.whole)
        size += sum(map(len, (name, parameter.value.content, parameter.description, parameter.constraints)))
        if page and size > _PAGE:
            break
        page.append(parameter)
    return ParametersAnswer(ask.request, tuple(page), more=len(page) < len(names))


async def _of_each(
    services: NodeServices, node: str, names: Sequence[str], service: str, kind: str, read: Callable[[bytes], list[T]]
) -> list[T | None]:
    """Return what a service tells of each parameter: of one that is gone or not set, perhaps None."""
    found = read(await services.call(node, service, kind, names_request(names), _READ_WITHIN)) if names else []
    if len(found) == len(names):
        return [*found]
    if len(names) == 1:
        return [None]
    # A node answers with nothing at all because of one name.
    half = len(names) // 2
    parts = [await _of_each(services, node, part, service, kind, read) for part in (names[:half], names[half:])]
    return parts[0] + parts[1]


async def read_pages(
    page: Callable[[AskParameters], Awaitable[ParametersAnswer]], node: str, names: Sequence[str], *, whole: bool
) -> tuple[NodeParameter, ...]:
    """Return all parameters of a node, or some, sorted by name.

    Args:
        page: answers each question.

    Raises:
        LinkError: an answer has a problem.
    """
    found: dict[str, NodeParameter] = {}
    for at in range(0, max(1, len(names)), MOST_NAMED):
        ask, more = AskParameters(0, node, tuple(names[at : at + MOST_NAMED]), whole=whole), True
        while more and len(found) < MOST_PARAMETERS:
            answer = await page(ask)
            if answer.problem:
                raise LinkError(answer.problem)
            # A peer that repeats its pages would be asked for ever.
            new = {each.name: each for each in answer.parameters if each.name > ask.after}
            found |= new
            more = answer.more and bool(new)
            ask = msgspec.structs.replace(ask, after=max(new, default=""))
    return tuple(found[name] for name in sorted(found))


def _parameter(
    name: str, descriptor: ReadDescriptor | None, value: ParameterValue | None, *, whole: bool
) -> NodeParameter:
    descriptor = descriptor or NO_DESCRIPTOR
    value = value if value is not None and value.content else ParameterValue(descriptor.type)
    size = len(value.content)
    if size <= (LARGEST_VALUE if whole else SHOWN_VALUE):
        size = 0
    else:
        value = ParameterValue(value.type)
    return NodeParameter(
        name, value, size, descriptor.read_only, descriptor.dynamic, descriptor.description, descriptor.constraints,
        descriptor.ranges,
    )  # fmt: skip


def is_settable(values: Sequence[NewValue]) -> bool:
    """Whether there are values, not too many, each once and of its type."""
    size = sum(len(each.value.content) for each in values)
    if len({each.name for each in values}) < len(values) or size > LARGEST_CHANGE or not 0 < len(values) <= MOST_SET:
        return False
    try:
        set_request(values)
    except ValueError:
        return False
    return True


def named(values: Sequence[NewValue]) -> str:
    """Return new values in a few words: ``max_speed = 0.5 and 2 more``."""
    return join_first([f"{each.name} = {each.value}" for each in values], _NAMED)


async def set_parameters(context: Context, services: NodeServices, node: str, values: Sequence[NewValue]) -> ChangeStep:
    """Have a node set all of some parameters, or none; none either if one is not as it was seen."""
    began, reason = context.now(), ""
    names = join_first([each.name for each in values], _NAMED)
    try:
        if reason := await _other_by_now(services, node, [each for each in values if each.seen]):
            return ChangeStep(node, "set", "", sanitize_text(reason), context.now() - began)
        is_done, why = read_set(await services.call(node, SET, SET_TYPE, set_request(values), _SET_WITHIN))
        if not is_done:
            why = why or ParametersProblem.NO_REASON()
            reason = ParametersProblem.REFUSED(node=node, names=names, reason=why)
    except NodeSilentError as error:
        reason = str(error)
    except MalformedAnswerError as error:
        reason = ParametersProblem.NO_ANSWER(node=node, error=error)
    return ChangeStep(node, "set", "", sanitize_text(reason), context.now() - began)


async def _other_by_now(services: NodeServices, node: str, values: Sequence[NewValue]) -> str:
    """Return a text about the first value that is not the one that was seen, or an empty string."""
    found = await _of_each(services, node, [each.name for each in values], GET, GET_TYPE, read_values)
    for new, value in zip(values, found, strict=True):
        present = value or ParameterValue()
        if present.digest != new.seen:
            text = str(present) if present.content else ParametersProblem.NOT_SET()
            return ParametersProblem.OTHER_BY_NOW(name=new.name, node=node, value=text)
    return ""
