"""Outages of 60 s and 30 % loss on virtual time: each message that the robot recorded is in the file, once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_extras.audit.comparing import AuditOptions, compare
from rsb_extras.courier.tests.backfill_cost import play
from rsb_extras.courier.tests.bags import in_bag

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_each_message_of_the_robot_is_there_once(seed: int, tmp_path: Path) -> None:
    one = play(seed, tmp_path)
    recorded, made = in_bag(one.robot), in_bag(one.path)
    offset = one.completed.clock.offset
    here = {each.there: each.name for each in one.completed.topics}
    assert [(here[each.channel.topic], each.time + offset, each.number, each.content) for each in recorded] == [
        (each.channel.topic, each.time, each.number, each.content) for each in made
    ]
    assert sum(each.live for each in one.completed.topics) > 1000
    assert sum(each.fetched for each in one.completed.topics) > 1000
    assert not any(each.only_live or each.missing for each in one.completed.topics)
    report = compare(one.robot, one.path, AuditOptions(pairs=[*here.items()]))
    assert not report.breaches, report.breaches
