"""Changes of nodes over one link: what its peer may see and ask for here, and what operators ask for there."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.feature_api import Asker, OrderAnswer, OrderBase, OrderEnd, OrderExtension, OrderQuestion, Questions
from rsb_extras.node_control.change_records import NO_COMPONENT, ChangeAction, ChangeOutcome, Component, Managed, Target
from rsb_extras.node_control.change_requests import LONGEST
from rsb_extras.node_control.node_changer import NodeChanger
from rsb_extras.node_control.parameter_records import AskParameters, NewValues, ParametersAnswer

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from rsb_bridge.feature_api import Link

_PAGE_WITHIN = 20.0
"""s for a page of parameters, of which the node has 6, and a thin line some more. A round figure."""


class AskManaged(OrderQuestion, frozen=True):
    """Asks for the other side's managed nodes, or for a ticket."""


class ManagedAnswer(OrderAnswer, frozen=True):
    """A side's managed nodes, or a ticket."""

    managed: Managed = Managed()


class RunChange(OrderBase, frozen=True):
    """Asks for a change.

    Attributes:
        values: parameters to be set, if that is the action, or of a component that is loaded.
        component: to be loaded or unloaded.
    """

    target: Target
    action: ChangeAction
    values: NewValues = ()
    component: Component = NO_COMPONENT


class ChangeEnded(OrderEnd[ChangeOutcome], frozen=True):
    """The end of a change, or why it was refused."""


class LinkChanges(OrderExtension[ManagedAnswer, RunChange, ChangeOutcome]):
    """One link's changes of nodes, in both directions."""

    question, answer, order, end, outcome = AskManaged, ManagedAnswer, RunChange, ChangeEnded, ChangeOutcome
    longest = LONGEST

    def __init__(self, link: Link) -> None:
        super().__init__(link)
        self.messages = {
            **self.messages,
            AskParameters: self._parameters_asked,
            ParametersAnswer: self._parameters_answered,
        }
        self._changer = link.context.shared(NodeChanger)
        self._changer.links.add(link)
        self._pages: Questions[ParametersAnswer] = Questions(link, _PAGE_WITHIN)
        self._page = 0  # the number of the last question

    def disconnected(self) -> None:
        super().disconnected()
        self._pages.disconnected()

    async def list_for(self, asker: Asker, request: int) -> ManagedAnswer:
        return ManagedAnswer(request, managed=await self._changer.managed(asker))

    def carry_out(self, order: RunChange, asker: Asker) -> Coroutine[None, None, ChangeOutcome]:
        return self._changer.run(order.target, order.action, asker, order.values, order.component)

    async def parameters(self, ask: AskParameters) -> ParametersAnswer:
        """Return the peer's answer to a question, whose number does not matter; raises as `list_of_peer`."""
        self.check_peer()
        self._page += 1
        return await self._pages.ask(self._page, msgspec.structs.replace(ask, request=self._page))

    def _parameters_asked(self, ask: AskParameters) -> None:
        self._pages.answer(ask.request, partial(self._changer.parameters, ask, Asker("", self._link)))

    def _parameters_answered(self, answer: ParametersAnswer) -> None:
        self._pages.answered(answer.request, answer)
