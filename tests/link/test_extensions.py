"""The features of a link are extensions, each registered in one place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.link.roles import ClientRole, ServerRole
from rsb_bridge.wire.codec import ReportParts, control_messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link


@pytest.fixture(params=["client", "server"])
def link(request: pytest.FixtureRequest, make_context: Callable[..., Context]) -> Link:
    role = ClientRole if request.param == "client" else ServerRole
    return role(make_context(role=request.param), {"robot1": ()}).links()[0]


def test_each_control_message_has_one_handler(link: Link) -> None:
    assert set(link.handlers) == {*control_messages(), ReportParts}
    registered = [each for extension in link.extensions._all for each in extension.messages]
    assert len(registered) == len(set(registered))
