"""A robot and a control PC on a cable, for benchmarks of what a bad link does to commands."""

from __future__ import annotations

import tempfile
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tests.network.conftest import Network
from tests.network.hosts import Cable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.network.hosts import Host

PC = "10.99.1.1"
"""The address of the control PC."""


class CableBed(NamedTuple):
    network: Network
    robot: Host
    pc: Host
    cable: Cable


@contextmanager
def cabled() -> Iterator[CableBed]:
    """Have two hosts on a cable.

    Raises:
        NoHostError: there are no network namespaces, as for who is not root.
    """
    with tempfile.TemporaryDirectory(prefix="rsb-bench-") as folder, closing(Network(Path(folder))) as network:
        robot, pc = network.host("robot"), network.host("pc")
        cable = Cable(robot, pc)
        cable.address(("10.99.1.2/24", f"{PC}/24"))
        yield CableBed(network, robot, pc, cable)
