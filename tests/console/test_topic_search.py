"""The add form's list while a side is slow to list its topics, or does not."""

from concurrent.futures import Future
from typing import Any

import pytest
from tests.console.driving import engine_as, gone, on_main, shown, until
from tests.console.scripted import ScriptedEngine
from tests.support import constants
from textual.pilot import Pilot

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import TopicInfo
from rsb_console.app import ConsoleApp


class SlowPeer(ScriptedEngine):
    """An engine whose peer answers on the test's command.

    Attributes:
        asked: the questions to the peer, oldest first.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.asked: list[Future[tuple[TopicInfo, ...]]] = []

    def topics(self, link: str | None = None) -> "Future[tuple[TopicInfo, ...]]":
        if link is None:
            return super().topics(link)
        self.commands.append(("topics", link))
        self.asked.append(Future())
        return self.asked[-1]

    @property
    def looks(self) -> int:
        return self.commands.count(("topics", None))


FAR = [TopicInfo("/far", "std_msgs/msg/String", "", None, 1, 0)]


@pytest.fixture(autouse=True)
def _look_often(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.FORM_LOOK_EVERY.set(monkeypatch, 0.05)


@on_main(make_engine=SlowPeer)
async def test_answer_that_takes_many_looks_fills_list(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "/camera/depth")  # this side's own
    await shown(pilot, "waiting for what the other side has")
    looks = engine_as(app, SlowPeer).looks
    await until(pilot, lambda: engine_as(app, SlowPeer).looks > looks + 3, "it goes on looking at this side")
    assert len(engine_as(app, SlowPeer).asked) == 1
    engine_as(app, SlowPeer).asked[0].set_result(tuple(FAR))
    await shown(pilot, "/far")
    await shown(pilot, "/camera/depth")


@on_main(make_engine=SlowPeer)
async def test_missing_answer_is_told_and_asked_again(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "/camera/depth")
    engine_as(app, SlowPeer).asked[0].set_exception(EngineError("robot1 did not answer"))
    await shown(pilot, "robot1 did not answer")
    await until(pilot, lambda: len(engine_as(app, SlowPeer).asked) > 1, "it asks again")
    engine_as(app, SlowPeer).asked[1].set_result(tuple(FAR))
    await shown(pilot, "/far")
    await gone(pilot, "robot1 did not answer")
