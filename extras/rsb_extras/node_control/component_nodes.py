"""The containers of this side: which there are with their components, and how one is loaded or unloaded."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording, join_first, sanitize_text
from rsb_extras.node_control.cdr_fields import MalformedAnswerError
from rsb_extras.node_control.change_records import MOST_CONTAINERS, NODE_NAME, ChangeStep, Container
from rsb_extras.node_control.component_messages import (
    LIST,
    LIST_TYPE,
    LOAD,
    LOAD_TYPE,
    UNLOAD,
    UNLOAD_TYPE,
    load_request,
    read_components,
    read_load,
    read_unload,
    unload_request,
)
from rsb_extras.node_control.lifecycle_messages import NO_FIELDS
from rsb_extras.node_control.node_services import NodeSilentError, nodes_serving

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import Context
    from rsb_extras.node_control.change_records import Component
    from rsb_extras.node_control.component_messages import LoadAnswer, LoadedComponent
    from rsb_extras.node_control.node_services import NodeServices
    from rsb_extras.node_control.parameter_records import NewValue

LISTED_WITHIN = 2.0  # s, of containers in a list, as of states
_LOOK_WITHIN, _CHANGED_WITHIN = 5.0, 60.0
"""s. Round figures: a component that is loaded may load a map."""
_NAMED = 5


class ComponentProblem(Wording):
    """The reason why a component is not loaded or unloaded."""

    NO_ANSWER = "{node}: its answer about its components cannot be read: {error}"
    NO_REASON = "it gives no reason"
    NOT_LOADED = "{node} does not load {what}: {reason}"
    NOT_UNLOADED = "{node} does not unload {what}: {reason}"
    NOT_IN = "{node} has no component {what}: it has {known}"
    SEVERAL = "{node} has {count} components named {what}: load them under different names"


async def container_names(context: Context) -> tuple[str, ...]:
    """Return the names of containers, sorted."""
    return await nodes_serving(context, LIST, LIST_TYPE, MOST_CONTAINERS)


async def listed_container(services: NodeServices, name: str) -> Container:
    """Return what a container has; one that does not answer has no answer."""
    try:
        found = await components_of(services, name, LISTED_WITHIN)
    except NodeSilentError:
        return Container(name, answers=False)
    return Container(name, tuple(dict.fromkeys(each.name for each in found)))


async def components_of(services: NodeServices, name: str, within: float = _LOOK_WITHIN) -> list[LoadedComponent]:
    """Return the components of a container, sorted by name; raise `NodeSilentError`."""
    try:
        found = read_components(await services.call(name, LIST, LIST_TYPE, NO_FIELDS, within))
    except MalformedAnswerError as error:
        raise NodeSilentError(ComponentProblem.NO_ANSWER(node=name, error=error)) from None
    return sorted(each for each in found if NODE_NAME.fullmatch(each.name))


async def load(
    context: Context, services: NodeServices, node: str, component: Component, parameters: Sequence[NewValue]
) -> ChangeStep:
    """Have a container load a component. The step has the node that is loaded, or the container."""
    began, what = context.now(), f"{component.package} {component.plugin}"
    request = load_request(component, parameters)
    try:
        answer = read_load(await services.call(node, LOAD, LOAD_TYPE, request, _CHANGED_WITHIN))
        reason = _reason(ComponentProblem.NOT_LOADED, node, what, answer)
        loaded = answer.name if answer.done and NODE_NAME.fullmatch(answer.name) else node
    except (NodeSilentError, MalformedAnswerError) as error:
        reason, loaded = _silence(node, error), node
    return ChangeStep(loaded, "load", "", sanitize_text(reason), context.now() - began)


async def unload(context: Context, services: NodeServices, node: str, component: str) -> ChangeStep:
    """Have a container unload a component, by its full name."""
    began = context.now()
    try:
        loaded = await components_of(services, node)
        count = Counter(each.name for each in loaded)
        if count[component] == 1:
            (number,) = (each.number for each in loaded if each.name == component)
            sent = services.call(node, UNLOAD, UNLOAD_TYPE, unload_request(number), _CHANGED_WITHIN)
            reason = _reason(ComponentProblem.NOT_UNLOADED, node, component, read_unload(await sent))
        elif count[component]:
            reason = ComponentProblem.SEVERAL(node=node, count=count[component], what=component)
        else:
            known = join_first([*count], _NAMED) or "none"
            reason = ComponentProblem.NOT_IN(node=node, what=component, known=known)
    except (NodeSilentError, MalformedAnswerError) as error:
        reason = _silence(node, error)
    return ChangeStep(component, "unload", "", sanitize_text(reason), context.now() - began)


def _reason(problem: ComponentProblem, node: str, what: str, answer: LoadAnswer) -> str:
    return "" if answer.done else problem(node=node, what=what, reason=answer.reason or ComponentProblem.NO_REASON())


def _silence(node: str, error: Exception) -> str:
    return str(error) if isinstance(error, NodeSilentError) else ComponentProblem.NO_ANSWER(node=node, error=error)
