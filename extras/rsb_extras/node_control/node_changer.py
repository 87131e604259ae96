"""Changes this side's nodes, one change at a time of each, for its operators and for other sides."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakSet

import msgspec

from rsb_bridge.feature_api import Level, Wording, are_parameters_open, armed_of_nodes, sanitize_text
from rsb_extras.node_control import GROUPS, MAY_CHANGE
from rsb_extras.node_control.change_records import (
    COMPONENT_ACTIONS,
    MOST_CHANGES,
    MOST_GROUPS,
    NO_COMPONENT,
    ChangeOutcome,
    ChangeStep,
    ChangeText,
    Container,
    ListedGroup,
    Managed,
    ManagedNode,
    NodeChange,
)
from rsb_extras.node_control.component_nodes import (
    components_of,
    container_names,
    listed_container,
    load,
    unload,
)
from rsb_extras.node_control.lifecycle_nodes import managed_names, managed_node, phases, transit
from rsb_extras.node_control.node_services import NodeServices, NodeSilentError
from rsb_extras.node_control.parameter_nodes import is_settable, named, nodes_with_parameters, page_of, set_parameters
from rsb_extras.node_control.parameter_records import LARGEST_CHANGE, MOST_SET, ParameterNode, ParametersAnswer
from rsb_extras.nodes import SHOW_NODES

if TYPE_CHECKING:
    from collections.abc import Awaitable, Iterable, Sequence

    from rsb_bridge.feature_api import Asker, Context, Link
    from rsb_extras.node_control.change_records import ChangeAction, Component
    from rsb_extras.node_control.parameter_records import AskParameters, NewValue

T = TypeVar("T")

STARTS, STARTS_WITHIN = 12, 60.0
"""The most changes by the other sides together in so many s, and as many by this side's operators. A round figure."""
_AT_ONCE = MOST_CHANGES // 3
"""Changes under way of the other sides, and of this one; as many that have ended are remembered."""
_LOOKED_EVERY = 1.0
"""s between two looks at all nodes, however many ask. A round figure."""


class ChangeCode(StrEnum):
    """Codes of the events that changes log; they stay as they are, for programs that read the log."""

    BEGAN = "node_control.began"
    ENDED = "node_control.ended"
    FAILED = "node_control.failed"
    REFUSED = "node_control.refused"


class ChangeProblem(Wording):
    """The reason why a change is refused or not done."""

    NO_VALUES = (
        "a change sets 1 to {most} parameters of one node, each once, with values of their types, {size} bytes at most"
    )
    NO_LOAD = "a component has a package and a plugin, and parameters with values of their types, {size} bytes at most"
    NO_CONTAINER = "{name} is no container: see rsb-console component list"
    NO_GROUP = "the session of {owner} lists no group {name}: see rsb-console lifecycle"
    BUSY = "{node} is being changed already: wait until that is over"
    FULL = "{count} changes are under way there: wait until one is over"
    TOO_OFTEN = "nodes were changed {most} times within {seconds:g} s: wait"
    ARMED = "{what} is armed, and one of the nodes takes it: disarm it first, or ask an operator of that side"
    STOPS = "the bridge stops: look at the nodes' states"
    ENDED = "an operator of its side ended it, for another change: look at the nodes' states"


@dataclass(slots=True, eq=False)
class _Doing:
    """A change that is under way.

    Attributes:
        work: asks the nodes; cancelled, it ends the change.
        outcome: of the change, as soon as its task is made.
    """

    target: str
    action: ChangeAction
    nodes: tuple[str, ...]
    asker: Asker
    began: float
    work: asyncio.Task[str]
    steps: list[ChangeStep] = field(default_factory=list)
    outcome: asyncio.Task[ChangeOutcome] | None = None


class NodeChanger:
    """Lists this side's managed nodes and groups, and changes them.

    Attributes:
        links: of the engine; what is armed on any of them counts.
        services: of the nodes.
    """

    def __init__(self, context: Context) -> None:
        self.links: WeakSet[Link] = WeakSet()
        self.services = NodeServices(context)
        self._context = context
        self._doing: list[_Doing] = []
        self._ended: deque[tuple[tuple[str, ...], NodeChange]] = deque(maxlen=_AT_ONCE)  # each with its nodes
        self._starts: dict[bool, deque[float]] = {is_own: deque(maxlen=STARTS) for is_own in (False, True)}
        self._found: tuple[ManagedNode, ...] = ()
        self._containers: tuple[Container, ...] = ()
        self._looking: asyncio.Task[None] | None = None
        self._looked_at = float("-inf")
        self._stops = False

    @property
    def _groups(self) -> dict[str, tuple[str, ...]]:
        return GROUPS.of(self._context.session)

    # --- what there is

    async def managed(self, asker: Asker) -> Managed:
        """Return managed nodes with their states, groups, containers and the last changes, as far as one may see."""
        shows = asker.link is None or SHOW_NODES.of(asker.link.end.rights)
        if asker.link is not None and not (shows or MAY_CHANGE.of(asker.link.end.rights)):
            return Managed()  # and no node is asked for a peer that sees none
        is_looking = self._looking is not None and not self._looking.done()
        if not is_looking and self._context.now() - self._looked_at >= _LOOKED_EVERY:
            self._looking = self._context.loop.create_task(self._look())
        if self._looking is not None:
            await asyncio.shield(self._looking)
        nodes = (msgspec.structs.replace(each, allowed=self._may(asker, each.name)) for each in self._found)
        groups = (
            ListedGroup(name, of_group, all(self._may(asker, each) for each in of_group))
            for name, of_group in tuple(self._groups.items())[:MOST_GROUPS]
        )
        containers = (msgspec.structs.replace(each, allowed=self._may(asker, each.name)) for each in self._containers)
        running = ((each.nodes, NodeChange(each.target, each.action, self._progress(each))) for each in self._doing)
        return Managed(
            tuple(each for each in nodes if shows or each.allowed),
            tuple(each for each in groups if shows or each.allowed),
            tuple(
                change
                for of_change, change in (*self._ended, *running)
                if shows or all(self._may(asker, each) for each in _named(change.action, of_change))
            ),
            tuple(each for each in containers if shows or each.allowed),
        )

    async def _look(self) -> None:
        names, containers = await asyncio.gather(managed_names(self._context), container_names(self._context))
        self._found, self._containers = await asyncio.gather(
            _all(managed_node(self.services, each) for each in names),
            _all(listed_container(self.services, each) for each in containers),
        )
        self._looked_at = self._context.now()

    def _progress(self, doing: _Doing) -> ChangeOutcome:
        return ChangeOutcome(is_over=False, seconds=self._context.now() - doing.began, steps=tuple(doing.steps))

    async def parameters(self, ask: AskParameters, asker: Asker) -> ParametersAnswer:
        """Return a page of a node's parameters, or the nodes that have some, as far as one may see them."""
        shows = asker.link is None or SHOW_NODES.of(asker.link.end.rights)
        if not ask.node:
            names = await nodes_with_parameters(self._context)
            nodes = (ParameterNode(each, self._may_set(asker, each)) for each in names)
            return ParametersAnswer(ask.request, nodes=tuple(each for each in nodes if shows or each.allowed))
        if not self._may_set(asker, ask.node):
            problem = self._lacks_right(ask.node, (ask.node,), asker, "read parameters of")
            return ParametersAnswer(ask.request, problem=sanitize_text(problem))
        return await page_of(self.services, ask)

    # --- changes

    async def run(
        self,
        target: str,
        action: ChangeAction,
        asker: Asker,
        values: Sequence[NewValue] = (),
        component: Component = NO_COMPONENT,
    ) -> ChangeOutcome:
        """Carry out a change, or refuse it. It goes on if nobody waits for it any more.

        An operator of this side does not wait for a peer's change, but ends it.
        """
        nodes = self._nodes(target)
        what = in_words(action, values, component)
        if problem := malformed(target, action, values, component):
            return ChangeOutcome(refused=True, reason=problem)
        if action in COMPONENT_ACTIONS and not self._lacks_right(target, nodes, asker):
            try:
                nodes += tuple(each.name for each in await components_of(self.services, target))
            except NodeSilentError as error:
                return self._refused(target, what, str(error), asker)
        while not (refusal := self._refusal(target, nodes, action, asker)) and (others := self._overlapping(nodes)):
            for each in others:
                each.work.cancel()
            await asyncio.wait([each.outcome for each in others if each.outcome is not None])
        if refusal:
            return self._refused(target, what, refusal, asker)
        self._starts[asker.link is None].append(self._context.now())
        asker.log(self._context, Level.INFO, ChangeCode.BEGAN, f"{target}: {what}")
        steps: list[ChangeStep] = []
        work = self._context.loop.create_task(self._work(nodes, action, steps, values, component))
        doing = _Doing(target, action, nodes, asker, self._context.now(), work, steps)
        self._doing.append(doing)
        doing.outcome = self._context.loop.create_task(self._carry_out(doing))
        return await asyncio.shield(doing.outcome)

    def _refused(self, target: str, what: str, reason: str, asker: Asker) -> ChangeOutcome:
        asker.log(self._context, Level.WARNING, ChangeCode.REFUSED, f"{target}: {what} refused: {reason}")
        return ChangeOutcome(refused=True, reason=sanitize_text(reason))

    def _nodes(self, target: str) -> tuple[str, ...]:
        return (target,) if "/" in target else self._groups.get(target, ())

    def _may(self, asker: Asker, node: str) -> bool:
        if asker.link is None:
            return True
        given = MAY_CHANGE.of(asker.link.end.rights)
        return any(node == each or node in self._groups.get(each, ()) for each in given)

    def _may_set(self, asker: Asker, node: str) -> bool:
        return self._may(asker, node) or _is_bridged(asker, node)

    def _overlapping(self, nodes: Sequence[str]) -> list[_Doing]:
        return [each for each in self._doing if not {*each.nodes}.isdisjoint(nodes)]

    def _refusal(self, target: str, nodes: Sequence[str], action: ChangeAction, asker: Asker) -> str:
        now, is_own = self._context.now(), asker.link is None
        is_bridged = action == "set" and _is_bridged(asker, target)
        if not is_bridged and (refusal := self._lacks_right(target, _named(action, nodes), asker)):
            return refusal
        if not nodes:
            return ChangeProblem.NO_GROUP(owner=self._context.session.name, name=target)
        if self._stops:
            return ChangeProblem.STOPS()
        others = self._overlapping(nodes)
        if lasting := [each for each in others if not is_own or each.asker.link is None]:
            busy = next(each for each in nodes if each in lasting[0].nodes)
            return ChangeProblem.BUSY(node=busy)
        if sum(is_own == (each.asker.link is None) for each in self._doing) >= _AT_ONCE:
            return ChangeProblem.FULL(count=_AT_ONCE)
        if sum(now - each < STARTS_WITHIN for each in self._starts[is_own]) >= STARTS:
            return ChangeProblem.TOO_OFTEN(most=STARTS, seconds=STARTS_WITHIN)
        # The robot's own operator knows what is driven there, and an entry has an arming of its own.
        what = (
            "" if asker.link is None or is_bridged else armed_of_nodes(self.links, nodes, self._context.ros, asker.link)
        )
        return ChangeProblem.ARMED(what=what) if what else ""

    def _lacks_right(self, target: str, nodes: Sequence[str], asker: Asker, act: str = "change") -> str:
        if asker.link is None:
            return ""
        # A group that is not listed is refused as one that may not be asked for: a peer learns nothing by asking.
        lacking = next((each for each in nodes if not self._may(asker, each)), "" if nodes else target)
        if not lacking:
            return ""
        return str(asker.link.end.rights.lacks(f"{act} {lacking}", MAY_CHANGE.entry(f"[{target}]")))

    async def _work(
        self,
        nodes: Sequence[str],
        action: ChangeAction,
        steps: list[ChangeStep],
        values: Sequence[NewValue],
        component: Component,
    ) -> str:
        """Have nodes take the steps of an action, up to the first that is not done, and return why it is not."""
        whom = self._context, self.services, nodes[0]
        if action == "set":
            steps.append(await set_parameters(*whom, values))
            return steps[0].reason
        if action == "load":
            steps.append(await load(*whom, component, values))
            return steps[0].reason
        if action == "unload":
            steps.append(await unload(*whom, component.name))
            return steps[0].reason
        for transition, in_order in phases(action, nodes):
            for node in in_order:
                step = await transit(self._context, self.services, node, transition)
                if step is None:
                    continue
                steps.append(msgspec.structs.replace(step, reason=sanitize_text(step.reason)))
                if step.reason:
                    return step.reason
        return ""

    async def _carry_out(self, doing: _Doing) -> ChangeOutcome:
        await asyncio.wait((doing.work,))
        if doing.work.cancelled():
            reason = (ChangeProblem.STOPS if self._stops else ChangeProblem.ENDED)()
        elif (error := doing.work.exception()) is not None:
            reason = f"{type(error).__name__}: {error}"
        else:
            reason = doing.work.result()
        seconds = self._context.now() - doing.began
        outcome = ChangeOutcome(reason=sanitize_text(reason), seconds=seconds, steps=tuple(doing.steps))
        self._doing.remove(doing)
        self._ended.append((doing.nodes, NodeChange(doing.target, doing.action, outcome)))
        self._looked_at = float("-inf")  # what has been found before is old
        level, code = (Level.INFO, ChangeCode.ENDED) if outcome.done else (Level.WARNING, ChangeCode.FAILED)
        doing.asker.log(self._context, level, code, f"{doing.target}: {ChangeText.of(doing.action, outcome)}")
        return outcome

    async def close(self) -> None:
        """End what is under way: no node is asked any more."""
        self._stops = True
        for each in self._doing:
            each.work.cancel()
        if self._looking is not None:
            self._looking.cancel()
        if ending := [each.outcome for each in self._doing if each.outcome is not None]:
            await asyncio.wait(ending)
        self.services.close()


def _named(action: ChangeAction, nodes: Sequence[str]) -> Sequence[str]:
    """Return the nodes of a change to which one needs the right: that to a container is that to its components."""
    return nodes[:1] if action in COMPONENT_ACTIONS else nodes  # they share a process


def _is_bridged(asker: Asker, node: str) -> bool:
    """Whether the other side can set a node's parameters by their services, too."""
    return asker.link is not None and are_parameters_open(asker.link, node)


async def _all(looks: Iterable[Awaitable[T]]) -> tuple[T, ...]:
    return tuple(await asyncio.gather(*looks))


def in_words(action: ChangeAction, values: Sequence[NewValue], component: Component) -> str:
    """Return what is asked for, for the log."""
    if action == "set":
        return f"set {named(values)}"
    if action == "unload":
        return f"unload {component.name}"
    if action == "load":
        return f"load {component.package} {component.plugin}{f' with {named(values)}' if values else ''}"
    return action


def malformed(target: str, action: ChangeAction, values: Sequence[NewValue], component: Component) -> str:
    """Return the reason why this is no change, or an empty string."""
    if action == "set" and ("/" not in target or not is_settable(values)):
        return ChangeProblem.NO_VALUES(most=MOST_SET, size=LARGEST_CHANGE)
    if action in COMPONENT_ACTIONS and "/" not in target:
        return ChangeProblem.NO_CONTAINER(name=target)
    is_loadable = component.package and component.plugin and (not values or is_settable(values))
    if action == "load" and not is_loadable:
        return ChangeProblem.NO_LOAD(size=LARGEST_CHANGE)
    return ""
