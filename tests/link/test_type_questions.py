"""A peer's answers about types are bounded, and accepted only if the type's hash proves them."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import zstandard
from tests.support import constants
from tests.support.slices import take
from tests.support.wording import pattern

from rsb_bridge.cdr.description import (
    DESCRIPTION_LIMIT,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    TypeVersion,
    difference_of_texts,
    hash_of_text,
    read_description,
)
from rsb_bridge.cdr.description import text_of as text_of_description
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.link.questions import TypeQuestions, description_in
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.ros.type_descriptions import TypeDescriptions
from rsb_bridge.wire.messages import AskType, TypeText

if TYPE_CHECKING:
    from collections.abc import Coroutine

TEXT = text_of_description(
    TypeDescription(MessageType("a_msgs/msg/B", (MessageField("x", FieldType(6, 0, 0, "")),)), ())
)
HASH = hash_of_text(TEXT)


class Ros(NoRos):
    """A side without installed types, whose nodes answer as a test sets them."""

    def __init__(self) -> None:
        self.nodes: dict[str, str | None] = {}
        self.asked: list[str] = []
        self.fails = False

    def publishers(self, topic: str) -> list[Any]:
        if self.fails:
            raise RosError("it is not running")
        return [type("End", (), {"node": node, "type_hash": HASH}) for node in self.nodes]

    def ask_description(self, *question: Any) -> str | None:
        node, _, _, still_wanted = question
        self.asked.append(node)
        assert still_wanted()
        return self.nodes[node]


class Route:
    id = 3
    type_name, type_hash, local_topic = "a_msgs/msg/B", HASH, "/b"

    def __init__(self, message_types: tuple[TypeVersion, ...] = (TypeVersion("a_msgs/msg/B", HASH),)) -> None:
        self.half = self.facts = self.carried = self
        self.message_types = message_types


class Side:
    """One side's questions and answers, on a clock of its own."""

    def __init__(self, ros: Ros | None = None, route: Route | None = None) -> None:
        self.ros, self.time = ros or Ros(), 0.0
        self.sent: list[Any] = []
        self.known = TypeDescriptions(self.ros, lambda: self.time)
        self.tasks: list[asyncio.Task[None]] = []
        self.has_sent = asyncio.Event()
        link: Any = SimpleNamespace(
            context=SimpleNamespace(descriptions=self.known, now=lambda: self.time),
            ids=SimpleNamespace(open_route=lambda _: route or Route()),
            linked=True,
            send=self._send,
            spawn=self._spawn,
        )
        self.link = link
        self.questions = TypeQuestions(link)

    def _send(self, message: Any) -> None:
        self.sent.append(message)
        self.has_sent.set()

    def _spawn(self, work: Coroutine[None, None, None]) -> None:
        self.tasks.append(asyncio.ensure_future(work))

    async def ask(self, answer: bytes | None) -> str:
        """Ask, and have the peer answer, or the link end if the answer is None."""
        asking = asyncio.ensure_future(self.questions.describe(Route()))  # type: ignore[arg-type]
        await self.has_sent.wait()
        assert self.sent == [AskType(route=3)]
        if answer is None:
            self.questions.disconnected()
        else:
            take(self.questions, TypeText(route=3, text=answer))
        return await asking


async def test_an_answer_that_proves_itself_is_kept() -> None:
    side = Side()
    assert await side.ask(zstandard.compress(TEXT.encode())) == TEXT
    take(side.questions, TypeText(route=3, text=b"late"))
    side.link.linked = False
    assert await side.questions.describe(Route()) == TEXT  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"garbage",
        zstandard.compress(b""),
        zstandard.compress(b"\xff\xfe"),
        zstandard.compress(TEXT.replace("x", "y").encode()),
        zstandard.compress(bytes(100 << 20)),
        zstandard.compress(b" " * (DESCRIPTION_LIMIT + 1)),
    ],
    ids=["unknown", "garbage", "empty", "no text", "another type", "a bomb", "too long"],
)
async def test_any_other_is_as_none(answer: bytes) -> None:
    with pytest.raises(LinkError, match=pattern(Denied.TYPE_NOT_INSTALLED, type_name="a_msgs/msg/B")):
        await Side().ask(answer)


async def test_peer_that_cannot_answer_may_have_type() -> None:
    with pytest.raises(LinkError, match=pattern(Denied.LINK_LOST)):
        await Side().ask(None)
    side = Side()
    side.link.linked = False
    with pytest.raises(LinkError, match=pattern(Denied.TYPE_NOT_HERE, type_name="a_msgs/msg/B")):
        await side.questions.describe(Route())  # type: ignore[arg-type]


async def test_answers_are_given_one_at_a_time() -> None:
    side = Side()
    side.ros.nodes = {"/node": TEXT}
    for _ in range(100):
        take(side.questions, AskType(route=3))
    await asyncio.gather(*side.tasks)
    (answer,) = side.sent
    assert zstandard.decompress(answer.text).decode() == TEXT
    assert side.ros.asked == ["/node"]


async def test_ignorant_nodes_are_asked_again_later() -> None:
    side = Side()
    side.ros.nodes = {f"/node{number}": TEXT.replace("x", "y") if number else None for number in range(9)}
    for moment in (0.0, 9.0, 11.0, 30.0, 32.0, 43.0):
        side.time = moment
        assert await side.known.find("a_msgs/msg/B", HASH, "/b") is None
    assert side.ros.asked == ["/node0", "/node1", "/node2"] * 3, "three at a time, and after 10 s and 20 s again"
    side.time, side.ros.fails = 130.0, True
    assert await side.known.find("a_msgs/msg/B", HASH, "/b") is None


def test_what_is_kept_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DESCRIPTIONS_KEPT.set(monkeypatch, 3 * len(TEXT))
    known = TypeDescriptions(Ros(), lambda: 0.0)
    texts = [TEXT.replace('"x"', f'"{letter}"') for letter in "abcde"]
    hashes = [hash_of_text(text) for text in texts]
    for text, type_hash in zip(texts[:3], hashes[:3], strict=True):
        assert known.add(text, type_hash)
    assert known.known(hashes[0]) == texts[0], "used, and so kept"
    assert known.add(texts[3], hashes[3])
    assert [known.known(each) is not None for each in hashes] == [True, False, True, True, False]
    assert not known.add(texts[4], hashes[0])


def described(name: str, field: str) -> str:
    """A request, response or message of one field."""
    return text_of_description(TypeDescription(MessageType(name, (MessageField(field, FieldType(6, 0, 0, "")),)), ()))


class Installed(Ros):
    def __init__(self, *texts: str) -> None:
        super().__init__()
        self.texts = {name_in(text): text for text in texts}

    def installed_hash(self, type_name: str) -> str | None:
        text = self.installed_description(type_name)
        return None if text is None else hash_of_text(text)

    def installed_description(self, type_name: str) -> str | None:
        return self.texts.get(type_name)


def name_in(text: str) -> str:
    return read_description(text, hash_of_text(text)).type_description.type_name


def versions(*texts: str) -> tuple[TypeVersion, ...]:
    return tuple(TypeVersion(name_in(text), hash_of_text(text)) for text in texts)


REQUEST, RESPONSE = described("a_msgs/srv/A_Request", "x"), described("a_msgs/srv/A_Response", "y")


async def test_question_to_node_holds_up_nobody_else() -> None:
    """A type that is installed, and one that nobody has described lately."""
    asked, answered = threading.Event(), threading.Event()

    class Slow(Installed):
        def ask_description(self, *_: Any) -> None:
            asked.set()
            answered.wait(60.0)

    side, unknown = Side(Slow(REQUEST)), hash_of_text(RESPONSE)
    assert await side.known.find("a_msgs/srv/A_Response", unknown, "/b") is None
    side.ros.nodes = {"/node": None}
    asking = asyncio.ensure_future(side.known.find("a_msgs/msg/B", HASH, "/b"))
    await asyncio.to_thread(asked.wait, 60.0)
    assert await side.known.find("a_msgs/srv/A_Request", hash_of_text(REQUEST), "/b") == REQUEST
    assert await side.known.find("a_msgs/srv/A_Response", unknown, "/b") is None
    assert not asking.done()
    answered.set()
    assert await asking is None


HERE = described("a_msgs/srv/A_Request", "z"), described("a_msgs/srv/A_Response", "z")


async def asked_by_a_caller(answering: Side) -> tuple[str, str]:
    """Have a side with other versions ask: the texts of the answer, and the difference that it tells."""
    asking, told = Side(Installed(*HERE)), asyncio.get_running_loop().create_future()
    asking.questions.compare(3, versions(REQUEST, RESPONSE), told.set_result)
    await asking.has_sent.wait()
    take(answering.questions, *asking.sent)
    await asyncio.gather(*answering.tasks)
    take(asking.questions, *answering.sent)
    return description_in(answering.sent[0].text) or "", await told


@pytest.mark.parametrize("most", [DESCRIPTION_LIMIT, len(REQUEST), 0])
def test_one_answer_has_all_fitting_types(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DESCRIPTION_LIMIT.set(monkeypatch, max(most, 1))
    answering = Side(Installed(REQUEST, RESPONSE), Route(versions(REQUEST, RESPONSE, REQUEST)))
    texts, difference = asyncio.run(asked_by_a_caller(answering))
    fit = [text for text, size in ((REQUEST, len(REQUEST)), (RESPONSE, DESCRIPTION_LIMIT)) if size <= most]
    assert texts == "\n".join(fit)
    assert difference == "; ".join(
        difference_of_texts(here, text) for here, text in zip(HERE, (REQUEST, RESPONSE), strict=True) if text in fit
    )
