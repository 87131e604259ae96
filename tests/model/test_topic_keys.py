"""The table of topic keys agrees with the struct that holds the values, and with the messages that carry them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from rsb_bridge.config.file_form import KEYS, LISTS
from rsb_bridge.model.session import Kind, Topic
from rsb_bridge.model.topic_keys import CORE_KEYS, TOPIC_KEYS
from rsb_bridge.wire.messages import Amend, Propose

_FIELDS = {field.name: field for field in msgspec.structs.fields(Topic)}


def test_each_field_is_a_key() -> None:
    assert CORE_KEYS.keys() == _FIELDS.keys() - {"kind", "features"}


@pytest.mark.parametrize("kind", LISTS)
def test_the_documentation_has_each_key(kind: Kind) -> None:
    """`docs/sessions.md` has a table for topics, and one with a sentence behind it for the other kinds."""
    heading = "Keys of a topic" if kind == "topic" else "Keys of services, actions and parameters"
    section = (
        (Path(__file__).parents[2] / "docs/sessions.md")
        .read_text()
        .partition(f"## {heading}\n")[2]
        .partition("\n## ")[0]
    )
    assert {key for key in KEYS[kind] if f"`{key}`" not in section} == set()


def test_what_is_live_can_be_amended() -> None:
    live = {name for name, key in TOPIC_KEYS.items() if key.live} | {"features"}
    assert live == set(Amend.__struct_fields__) - {"route", "who"}
    assert live <= set(Propose.__struct_fields__)


def test_messages_check_each_range_but_the_timeouts() -> None:
    ranges = {name: key.limits for name, key in TOPIC_KEYS.items() if key.limits is not None and name != "timeout"}
    proposal = Propose(route=1, topic="/scan", remote_topic="/scan", from_client=True)
    for name, limits in ranges.items():
        for value in (limits.low / 2, limits.high * 2):
            with pytest.raises(ValueError, match="0 or"):
                msgspec.structs.replace(proposal, **{name: value})
