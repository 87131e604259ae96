"""Fixtures of the tests that run the whole bridge. ROS is imported by those that ask for it."""

from __future__ import annotations

import gc
import sys
from typing import TYPE_CHECKING, Any

import pytest
from _pytest.unraisableexception import gc_collect_iterations_key
from tests.support.locks import two_domains

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain
    from tests.support.program import Programs
    from tests.support.relay import Relay


def pytest_configure(config: pytest.Config) -> None:
    """Have the cycle collector run less often: a Textual app makes so many objects that it took 15 % of the time.

    At the end pytest would collect five times (for PyPy), which takes seconds after the console's tests.
    """
    gc.set_threshold(100_000, 20, 20)
    config.stash[gc_collect_iterations_key] = 1


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--share 1/3`` runs every third file, from the first on, so that a large folder is run by three processes."""
    parser.addoption("--share", metavar="K/N", help="run every N-th file, from the K-th on")
    parser.addoption("--random", action="store_true", help="Hypothesis draws new examples, and more of them")


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> None:
    """Have Hypothesis draw the same examples in each run, unless `--random` is given.

    An example may take its time: by itself Hypothesis fails a test of which one takes 0.2 s. To be said before a test
    is made of them, and only where there are any: to import it takes 0.1 s.
    """
    if b"hypothesis" in module_path.read_bytes():
        from hypothesis import HealthCheck, settings

        random = parent.config.getoption("random")
        settings.register_profile(
            "patient",
            deadline=None,
            max_examples=100 if random or module_path.parent.name == "wire" else 30,  # its coverage must be complete
            derandomize=not random,
            suppress_health_check=[HealthCheck.too_slow],
        )
        settings.load_profile("patient")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out the files of other shares, without reading them."""
    share = config.getoption("share")
    if not share or not collection_path.match("test_*.py"):
        return None
    first, every = map(int, share.split("/"))
    return collection_path not in sorted(collection_path.parent.glob("test_*.py"))[first - 1 :: every] or None


def pytest_collection_finish(session: pytest.Session) -> None:
    """Where no test uses Hypothesis, its plugin would import it at the end, only to have nothing to say."""
    if "hypothesis" not in sys.modules:
        session.config.pluginmanager.unregister(name="hypothesispytest")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Say with a failure what the ROS participants of this process do not agree about."""
    report = yield
    participants = sys.modules.get("tests.support.participants")
    if report.failed and participants is not None:
        report.sections.append(("What participants do not agree about", participants.differences()))
    return report


@pytest.fixture(scope="session", autouse=True)
def _own_control_sockets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Bridges that others run on this machine are not the tests' business, nor theirs the others'; nor their files."""
    from rsb_bridge.control import control_sockets

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        patch.setenv("RSB_CONSOLE_ISOLATED", "1")
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        nobodys = tmp_path_factory.mktemp("nobody")
        patch.setattr(control_sockets, "_fallback_folder", lambda: nobodys / "rsb-console")
        patch.setattr(control_sockets, "SERVICES", nobodys / "services")
        yield


@pytest.fixture(scope="session")
def _domains() -> int:
    """The first of two domains that no other run on this machine uses."""
    return two_domains()


@pytest.fixture(scope="session")
def _further_domains() -> int:
    """The first of two more."""
    return two_domains()


@pytest.fixture(scope="session")
def _robot_domain(_domains: int) -> Iterator[Domain]:
    yield from _domain(_domains)


@pytest.fixture(scope="session")
def _pc_domain(_domains: int) -> Iterator[Domain]:
    yield from _domain(_domains + 1)


def _domain(domain_id: int) -> Iterator[Domain]:
    from tests.support.domain import Domain

    domain = Domain(domain_id)
    yield domain
    domain.close()


@pytest.fixture
def robot(_robot_domain: Domain) -> Iterator[Domain]:
    """The client's domain."""
    yield _robot_domain
    _robot_domain.clear()


@pytest.fixture
def pc(_pc_domain: Domain) -> Iterator[Domain]:
    """The server's domain."""
    yield _pc_domain
    _pc_domain.clear()


@pytest.fixture
def third(_further_domains: int) -> Iterator[Domain]:
    """A domain beside those two."""
    yield from _domain(_further_domains)


@pytest.fixture
def bridge(tmp_path: Path, robot: Domain, pc: Domain) -> Iterator[Bridge]:
    """Makes engines, and stops them at the end."""
    from tests.support.bridge import Bridge

    made = Bridge(tmp_path, robot, pc)
    yield made
    made.close()


@pytest.fixture
def relay(bridge: Bridge) -> Iterator[Relay]:
    """A network between the clients and the server that `bridge` makes."""
    from tests.support.relay import same_port

    made = same_port(bridge.port)
    bridge.through(made)
    yield made
    bridge.close()
    made.close()


@pytest.fixture
def programs(bridge: Bridge) -> Iterator[Programs]:
    """Starts the real program on sessions that `bridge` makes."""
    from tests.support.program import Programs

    made = Programs(bridge.folder)
    yield made
    made.close()


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    """Serves engines on control sockets of the test's own, and attaches to them."""
    from tests.support.control import Machine

    made = Machine(tmp_path)
    yield made
    made.close()
