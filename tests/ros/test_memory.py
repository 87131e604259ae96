"""The memory of large messages goes back to the kernel."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from tests.support import constants, replaced
from tests.support.resources import resources
from tests.support.waiting import eventually

from rsb_bridge.ros import memory

if TYPE_CHECKING:
    import pytest

_LARGE = """
import contextlib
import sys
from tests.support import participants
from tests.support.resources import resources
from tests.support.waiting import eventually
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros import memory
from rsb_bridge.ros.ros_interface import TopicSpec

memory._HEAP_TRIMMED_EVERY = 0.05
participants._announced_often = contextlib.nullcontext  # its profile would stand in place of the bridge's
sender = participants.KnownNode(int(sys.argv[1]), "sender")
sender.start()
latched = Qos(durability="transient_local", depth=100)
publisher = sender.advertise(TopicSpec("/large", "made_up_msgs/msg/Blob", "RIHS01_" + "5b" * 32, latched), "link")
before = resources().resident
for _ in range(latched.depth):
    publisher.publish(bytes(1 << 20))
assert resources().resident > before + (90 << 20)
for _ in range(latched.depth):
    publisher.publish(bytes(16))
eventually(lambda: resources().resident < before + (16 << 20))
sender.stop()
"""


def test_what_history_held_goes_back_to_kernel(spare_domains: int) -> None:
    """A publisher kept 100 messages of 1 MB, and then as many small ones: without the profile, 100 MB stay."""
    command = [sys.executable, "-c", _LARGE, str(spare_domains)]
    subprocess.run(command, cwd=Path(__file__).parents[2], timeout=300, check=True)


def test_a_users_profiles_have_priority() -> None:
    for name in "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML":
        environment = {name: "mine"}
        with memory.histories_that_shrink(environment):
            assert environment == {name: "mine"}


def test_children_inherit_no_profile() -> None:
    environment: dict[str, str] = {}
    with memory.histories_that_shrink(environment):
        assert environment
    assert not environment


def test_free_memory_goes_back_to_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.HEAP_TRIMMED_EVERY.set(monkeypatch, 0.05)
    threads = threading.active_count()
    with memory.large_blocks_kept():
        blocks = [b"x" * (6 << 20) for _ in range(8)]
        most = resources().resident
        blocks.clear()
        eventually(lambda: resources().resident < most - (32 << 20))
    assert threading.active_count() <= threads  # one that a test before left may have ended


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.MEMORY_LIBRARY.set(monkeypatch, lambda _: object())
    before = threading.active_count()
    with memory.large_blocks_kept():
        assert threading.active_count() <= before
