"""The features of a link are extensions, each registered in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import pytest

from rsb_bridge.link.extension import Extension
from rsb_bridge.link.roles import ClientRole, ServerRole
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.purposes import Purpose
from rsb_bridge.wire.codec import ReportParts, TopicListParts
from rsb_bridge.wire.messages import ControlMessage, Neighbours

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link


@pytest.fixture(params=["client", "server"])
def link(request: pytest.FixtureRequest, make_context: Callable[..., Context]) -> Link:
    """Either side's end of a link."""
    role = ClientRole if request.param == "client" else ServerRole
    return role(make_context(role=request.param), {"robot1": ()}).links()[0]


def test_each_control_message_has_one_handler(link: Link) -> None:
    assert set(link.handlers) == {*get_args(ControlMessage), ReportParts, TopicListParts}
    registered = [each for extension in link._extensions for each in extension.messages]
    assert len(registered) == len(set(registered))


def test_a_feature_takes_part_in_ticks_losses_and_messages(link: Link) -> None:
    said: list[object] = []

    class Feature(Extension):
        """A feature that records its calls."""

        def __init__(self, name: str) -> None:
            self.name = name
            self.messages = {Neighbours: said.append}

        def tick(self) -> None:
            said.append(f"{self.name} ticks")

        def disconnected(self) -> None:
            said.append(f"{self.name} stops")

        def refusal(self, name: str) -> str:
            return f"{self.name} refuses {name}" if name == "bench/no" else ""

    first, last = link.extend(Feature("first")), link.extend(Feature("last"))
    link.handlers[Neighbours](Neighbours(bridges=("here",)))
    link.tick()
    link.lost("cut", EventCode.LINK_LOST)
    assert said == [Neighbours(bridges=("here",)), "first ticks", "last ticks", "last stops", "first stops"]
    first.purpose, last.purpose = Purpose("bag"), Purpose("file")
    assert link.refusal("bench/no", first.purpose) == "first refuses bench/no"
    assert not link.refusal("bench/yes", first.purpose)
