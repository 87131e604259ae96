"""The bytes of commands. Whatever changes them needs another `rsb_bridge.control.protocol.VERSION`."""

from __future__ import annotations

from typing import Any, get_args

import msgspec
import pytest

from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import CommandRequest
from rsb_bridge.model import commands as c
from rsb_bridge.model.benchmark import BenchmarkStep
from rsb_bridge.model.pictures import Wish
from rsb_bridge.model.session import Client, Topic

SCAN = Topic("/scan", "transmit")
CMD = Topic("/cmd", "receive", arm=True, max_rate=5.0, max_age=1.0)
SCAN_BYTES = b"\xde\x00\x02\xa5topic\xa5/scan\xa9direction\xa8transmit"
CMD_BYTES = (
    b"\xde\x00\x05\xa5topic\xa4/cmd\xa9direction\xa7receive\xa8max_rate\xcb@\x14\x00\x00\x00\x00\x00\x00"
    b"\xa7max_age\xcb?\xf0\x00\x00\x00\x00\x00\x00\xa3arm\xc3"
)
RECORDED: tuple[tuple[c.AnyCommand, bytes], ...] = (
    (c.AddTopic(SCAN), b"\x82\xa2is\xa3add\xa5topic" + SCAN_BYTES),
    (c.AddTopic(CMD, "robot1"), b"\x83\xa2is\xa3add\xa5topic" + CMD_BYTES + b"\xa4link\xa6robot1"),
    (c.EditTopic("k", CMD), b"\x83\xa2is\xa4edit\xa3key\xa1k\xa5topic" + CMD_BYTES),
    (c.EditTopic("k", SCAN, True), b"\x84\xa2is\xa4edit\xa3key\xa1k\xa5topic" + SCAN_BYTES + b"\xa8drop_arm\xc3"),
    (c.RemoveTopic("k"), b"\x82\xa2is\xa6remove\xa3key\xa1k"),
    (c.RemoveTopic("k", True), b"\x83\xa2is\xa6remove\xa3key\xa1k\xa8drop_arm\xc3"),
    (c.PauseTopics("k", True), b"\x83\xa2is\xa5pause\xa3key\xa1k\xa6paused\xc3"),
    (c.PauseTopics("k", False), b"\x83\xa2is\xa5pause\xa3key\xa1k\xa6paused\xc2"),
    (c.Acknowledge("k"), b"\x82\xa2is\xabacknowledge\xa3key\xa1k"),
    (c.Acknowledge("", False, "robot1"), b"\x83\xa2is\xabacknowledge\xacacknowledged\xc2\xa4link\xa6robot1"),
    (c.ArmTopic("k"), b"\x82\xa2is\xa3arm\xa3key\xa1k"),
    (c.AskHolder("k"), b"\x82\xa2is\xaaask_holder\xa3key\xa1k"),
    (c.TakeArming("k", True), b"\x83\xa2is\xabtake_arming\xa3key\xa1k\xa6shared\xc3"),
    (c.AnswerAsker("k", True), b"\x83\xa2is\xacanswer_asker\xa3key\xa1k\xa5gives\xc3"),
    (c.DisarmTopic("k"), b"\x82\xa2is\xa6disarm\xa3key\xa1k"),
    (c.DisarmTopic("k", True), b"\x83\xa2is\xa6disarm\xa3key\xa1k\xa3own\xc3"),
    (c.KeepArmed(True), b"\x82\xa2is\xaakeep_armed\xa7pressed\xc3"),
    (c.KeepArmed(False), b"\x82\xa2is\xaakeep_armed\xa7pressed\xc2"),
    (c.ReleaseArmed(), b"\x81\xa2is\xadrelease_armed"),
    (c.AddClient(Client("r")), b"\x82\xa2is\xaaadd_client\xa6client\x81\xa4name\xa1r"),
    (
        c.ChangeClient(Client("r", topics=(SCAN,))),
        b"\x82\xa2is\xadchange_client\xa6client\x82\xa4name\xa1r\xa6topics\x91" + SCAN_BYTES,
    ),
    (c.RemoveClient("r"), b"\x82\xa2is\xadremove_client\xa4name\xa1r"),
    (c.Retry(), b"\x81\xa2is\xa5retry"),
    (c.Retry("robot1"), b"\x82\xa2is\xa5retry\xa4link\xa6robot1"),
    (c.ShutDownLinks(), b"\x81\xa2is\xa9shut_down"),
    (c.Restart(), b"\x81\xa2is\xa7restart"),
    (c.Reload(), b"\x81\xa2is\xa6reload"),
    (c.Reload(True), b"\x82\xa2is\xa6reload\xa7dry_run\xc3"),
    (c.Reload(drop_arm=True), b"\x82\xa2is\xa6reload\xa8drop_arm\xc3"),
    (c.Topics(), b"\x81\xa2is\xa6topics"),
    (c.Topics("robot1"), b"\x82\xa2is\xa6topics\xa4link\xa6robot1"),
    (c.Peek("k"), b"\x82\xa2is\xa4peek\xa3key\xa1k"),
    (c.Peek("k", True), b"\x83\xa2is\xa4peek\xa3key\xa1k\xa4kept\xc3"),
    (
        c.LookAtTopics("v", ("/map", "/tf"), Wish(width=100, how="map"), "r1"),
        b"\x85\xa2is\xa4look\xa6viewer\xa1v\xa6topics\x92\xa4/map\xa3/tf\xa4wish\xde\x00\x02\xa5widthd\xa3how\xa3map\xa4link\xa2r1",
    ),
    (c.EndLook("v"), b"\x82\xa2is\xa8end_look\xa6viewer\xa1v"),
    (c.DraftMessage("/t"), b"\x82\xa2is\xa5draft\xa5topic\xa2/t"),
    (c.DraftMessage("/t", "T"), b"\x83\xa2is\xa5draft\xa5topic\xa2/t\xa9type_name\xa1T"),
    (c.Publish("/t", "{}"), b"\x83\xa2is\xa7publish\xa5topic\xa2/t\xa6fields\xa2{}"),
    (
        c.Publish("/t", "{x: 1}", "T", 5, "{}", 0.25),
        (
            b"\x87\xa2is\xa7publish\xa5topic\xa2/t\xa6fields\xa6{x: 1}\xa9type_name\xa1T\xa6ticket\x05\xa4rest\xa2{}"
            b"\xaarest_after\xcb?\xd0\x00\x00\x00\x00\x00\x00"
        ),
    ),
    (c.DescribeType("k"), b"\x82\xa2is\xa8describe\xa3key\xa1k"),
    (c.Template("k"), b"\x82\xa2is\xa8template\xa3key\xa1k"),
    (c.Template("k", "send_goal"), b"\x83\xa2is\xa8template\xa3key\xa1k\xa4lane\xa9send_goal"),
    (c.Call("k", "{}"), b"\x83\xa2is\xa4call\xa3key\xa1k\xa7request\xa2{}"),
    (c.Call("k", "{data: true}", "l"), b"\x84\xa2is\xa4call\xa3key\xa1k\xa7request\xac{data: true}\xa4lane\xa1l"),
    (c.History(60.0), b"\x82\xa2is\xa7history\xa7seconds\xcb@N\x00\x00\x00\x00\x00\x00"),
    (c.Bench(BenchmarkStep()), b"\x82\xa2is\xa5bench\xa5order\x80"),
    (c.Stop(), b"\x81\xa2is\xa4stop"),
)
"""Commands, and their bytes in a request with the id 7."""


@pytest.mark.parametrize(("command", "recorded"), RECORDED, ids=lambda each: type(each).__name__)
def test_the_bytes_are_as_recorded(command: Any, recorded: bytes) -> None:
    body = b"\x83\xa2is\xa7request\xa2id\x07\xa7command" + recorded
    frame = len(body).to_bytes(4, "big") + body
    assert protocol.encode(CommandRequest(7, command)) == frame
    assert list(protocol.frames_to_bridge().feed(frame)) == [CommandRequest(7, command)]


def test_every_command_is_recorded() -> None:
    assert {type(command) for command, _ in RECORDED} == set(get_args(c.AnyCommand))


def test_a_request_that_takes_back_an_earlier_one_says_so() -> None:
    assert msgspec.msgpack.decode(protocol.encode(CommandRequest(8, c.Retry(), undo=True))[4:]) == {
        "is": "request",
        "id": 8,
        "command": {"is": "retry"},
        "undo": True,
    }
