"""Months of services that come and go in any state leave nothing behind."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.long import long_cases
from tests.support.resources import resources
from tests.support.waiting import eventually

from rsb_bridge.ros.native.named_types import named_services
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.node import RosNode

SET = "std_srvs/srv/SetBool"
MADE_UP = "made_up_msgs/srv/Set", "RIHS01_" + "5a" * 32 + "+RIHS01_" + "a5" * 32
REQUEST, RESPONSE = b"\0\1\0\0\1", b"\0\1\0\0" + bytes(9)
ROUND = 60
ROUNDS = 3
NAMES = 7


def mapped() -> set[str]:
    lines = Path("/proc/self/maps").read_text().splitlines()
    return {line.split()[-1] for line in lines if "/dev/shm/" in line}


@pytest.mark.parametrize(
    ("way", "kind"),
    [("raw", MADE_UP), *long_cases(("raw", (SET, "")), ("typed", (SET, "")))],
    indirect=["way"],
    ids=str,
)
@pytest.mark.usefixtures("way")
def test_hundreds_of_services_and_clients_leave_nothing(
    open_node: Callable[..., RosNode], printed: Callable[[], list[str]], kind: tuple[str, str]
) -> None:
    """They go before they are matched, with a request in flight, with one that has no answer, and when all is done."""
    gc.collect()  # leftovers of earlier tests' stock nodes are reported by now
    printed()
    near, far = open_node(), open_node(name="other")
    failures: list[Any] = []
    for node in (near, far):
        node.watch(lambda: None, failures.append)

    def once(number: int) -> None:
        requests: list[Any] = []
        responses: list[Any] = []
        name = f"/set{number % NAMES}"
        server = near.serve(name, *kind, requests.extend, failures.append)
        client = far.call_service(name, *kind, responses.extend, failures.append)
        if number % 4:
            eventually(lambda: client.ready)
            client.call(REQUEST)
        if number % 4 > 1:
            eventually(lambda: requests)
        if number % 4 == 3:
            server.answer(requests[0].caller, RESPONSE)
            eventually(lambda: responses)
        client.close()
        server.close()

    def rounds(count: int) -> Any:
        for number in range(count * ROUND):
            once(number)
        eventually(lambda: not any(each._retired for each in (near, far)))
        eventually(lambda: not named_services.used)
        eventually(lambda: not (near.services().keys() | far.services().keys()) & {f"/set{n}" for n in range(NAMES)})
        gc.collect()
        return resources(), mapped(), named_services.made

    before, mapped_before, made = rounds(1)
    after, mapped_after, made_after = rounds(ROUNDS)
    assert not failures
    assert after.threads <= before.threads
    assert after.descriptors <= before.descriptors
    assert after.resident - before.resident < 4 << 20
    assert len(mapped_after - mapped_before) < ROUND  # other programs in the domain have theirs
    assert made_after <= made + 1
    assert not printed()


def test_services_that_cannot_be_leave_nothing(open_node: Callable[..., RosNode]) -> None:
    node = open_node()
    node.serve("/taken", SET, "", print)
    used = named_services.used

    def refused() -> None:
        for name, type_name, type_hash in (
            ("/no name", SET, ""), ("/no name", *MADE_UP), ("/taken", *MADE_UP), ("/other", "made_up_msgs/srv/Set", ""),
        ):  # fmt: skip
            for make in (node.serve, node.call_service):
                with pytest.raises(RosError):
                    make(name, type_name, type_hash, print)

    for _ in range(20):
        refused()
    before = resources()
    for _ in range(100):
        refused()
    after = resources()
    assert named_services.used == used
    assert after.threads <= before.threads
    assert after.descriptors <= before.descriptors
    assert after.resident - before.resident < 4 << 20
