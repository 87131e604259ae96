"""The command ``look`` shows the age of the picture in sight, whether new ones come or not."""

from __future__ import annotations

from argparse import Namespace
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.support.wording import has_text

from rsb_bridge.api import EngineError
from rsb_bridge.model.pictures import Cells, Picture, Pixels, Viewed
from rsb_console.command import look_command
from rsb_console.command.look_command import LookText
from rsb_console.look import formats

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import RemoteEngine

ARGUMENTS = Namespace(
    topics=["/t"], link="", width=40, height=5, rate=2.0, how="", field=[], zoom=1.0, tilt=0.0, frame="",
    colour="height", seconds=30.0, match="", ascii=True, json=False, timeout=None, output=None,
)  # fmt: skip
PICTURE = Viewed(Picture(Cells(("picture",))), "robot1", 0.5)
STEP = 4.0


class Engine:
    """Answers each question with the next of its answers, and further ones never."""

    def __init__(self, *answers: Viewed | Exception) -> None:
        self._answers = list(answers)

    def look(self, *_: Any) -> Future[Viewed]:
        future: Future[Viewed] = Future()
        if self._answers:
            answer = self._answers.pop(0)
            if isinstance(answer, Exception):
                future.set_exception(answer)
            else:
                future.set_result(answer)
        return future


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """Return what the command draws, one time after another, `STEP` seconds apart."""

    def draw(*answers: Viewed | Exception, times: int) -> list[str]:
        now, waits = [100.0], [0]

        def wait(*_: Any) -> None:
            waits[0] += 1
            now[0] += STEP
            if waits[0] > times:
                raise KeyboardInterrupt

        monkeypatch.setattr(look_command, "wait", wait)
        monkeypatch.setattr("time.monotonic", lambda: now[0])
        monkeypatch.setattr("time.sleep", lambda _: None)
        with pytest.raises(KeyboardInterrupt):
            look_command._many(cast("RemoteEngine", Engine(*answers)), ARGUMENTS)
        return capsys.readouterr().out.split("\x1b[H")[1:]

    return draw


def test_the_age_of_a_picture_goes_on(drawn: Callable[..., list[str]]) -> None:
    first, second, third = drawn(PICTURE, times=3)
    for screen, age in ((first, 0.5), (second, 0.5 + STEP), (third, 0.5 + 2 * STEP)):
        assert LookText.AGE(age=formats.age(age)) in screen
        assert "picture" in screen


def test_the_last_picture_stays_beside_a_problem(drawn: Callable[..., list[str]]) -> None:
    _, second = drawn(PICTURE, EngineError("gone"), times=2)
    assert "gone" in second
    assert "picture" in second


def test_a_damaged_picture_does_not_end_the_command(drawn: Callable[..., list[str]]) -> None:
    damaged = Viewed(Picture(Pixels(2, 2, b"RIFFxxxxWEBP", "webp")))
    _, second = drawn(damaged, PICTURE, times=2)
    assert "picture" in second


def test_before_the_first_message(drawn: Callable[..., list[str]]) -> None:
    (first,) = drawn(times=1)
    assert has_text(first, LookText.NO_MESSAGE)
