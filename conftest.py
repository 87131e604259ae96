"""Fixtures of the tests that run the whole bridge. Only fixtures that need ROS import it."""

from __future__ import annotations

import gc
import os
import shlex
import sys
import time
import traceback
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from _pytest.unraisableexception import gc_collect_iterations_key
from tests.support import constants, replaced
from tests.support.locks import domains_of

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain
    from tests.support.program import Programs
    from tests.support.relay import Relay


pytest_plugins = ("tests.support.left_sockets", "tests.support.lost_workers")


def pytest_configure(config: pytest.Config) -> None:
    """Have the cycle collector run less often: a Textual app makes so many objects that it took 15 % of the time.

    At the end pytest would collect five times (for PyPy), which takes seconds after the console's tests.
    """
    gc.set_threshold(100_000, 20, 20)
    for name in ("COLUMNS", "LINES"):  # readline puts them where only a child sees them: a worker of pytest-xdist
        os.environ.pop(name, None)
    config.stash[gc_collect_iterations_key] = 1


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--random", action="store_true", help="Hypothesis draws new examples, and more of them")


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> None:
    """Have Hypothesis draw the same examples in each run, unless `--random` is given.

    An example may take its time: by itself Hypothesis fails a test of which one takes 0.2 s. To be said before a test
    is made of them, and only where there are any: to import it takes 0.1 s.
    """
    if b"hypothesis" in module_path.read_bytes():
        from hypothesis import HealthCheck, settings

        config = parent.config
        random = config.getoption("random")
        settings.register_profile(
            "patient",
            deadline=None,
            max_examples=100 if random else 30,
            derandomize=not random,
            suppress_health_check=[HealthCheck.too_slow],
        )
        settings.load_profile("patient")


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a worker of pytest-xdist whether it runs lanes; its own ``--dist`` says ``no``."""
    node.workerinput["lanes"] = node.config.getoption("dist") == "loadscope"


def _has_lanes(config: pytest.Config) -> bool:
    return bool(getattr(config, "workerinput", {}).get("lanes"))


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, Any, Any]:
    """Have one worker write the bytecode of all tests, so that the others read it: to rewrite assertions takes 5 s."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return (yield)
    written = Path(session.config.option.basetemp).parent / "bytecode-is-written"
    if worker["workerid"] == "gw0":
        try:
            return (yield)
        finally:
            written.touch()
    deadline = time.monotonic() + 60
    while not written.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    return (yield)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With ``-n N --dist loadscope``, N workers run lanes of tests."""
    if config.getoption("dist") != "loadscope":
        return None
    from tests.support.lanes import Lanes

    config.option.loadscopereorder = False
    return Lanes(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if _has_lanes(config):
        from tests.support.lanes import sort_by_lane

        sort_by_lane(items)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if _has_lanes(item.config):
        from tests.support.lanes import give_way

        give_way(item)


def pytest_unconfigure() -> None:
    """End what forks processes: a worker of pytest-xdist leaves out what Python does at an exit."""
    if (forker := sys.modules.get("tests.support.forker")) is not None:
        forker.end()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None]:
    """End with the command that runs again what failed."""
    yield
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:  # in a worker
        return
    failed = [*reporter.stats.get("failed", ()), *reporter.stats.get("error", ())]
    if found := dict.fromkeys(report.nodeid for report in failed if report.nodeid.startswith(("tests/", "extras/"))):
        reporter.write_line(f"\nAgain: {sys.executable} -m pytest {shlex.join(found)}", red=True)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Remove Hypothesis's plugin if no test uses it: at the end it would import Hypothesis and report nothing."""
    if "hypothesis" not in sys.modules:
        session.config.pluginmanager.unregister(name="hypothesispytest")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Say with a failure what the ROS participants of this process do not agree about."""
    try:
        report = yield
    except (TypeError, Warning):
        # pytest 8.4 fails itself, and ends the whole run, at a line that Python 3.11 does not know.
        assert call.excinfo is not None
        text = "".join(traceback.format_exception(call.excinfo.value))
        with pytest.raises(pytest.fail.Exception) as call.excinfo:
            pytest.fail(text, pytrace=False)
        report = pytest.TestReport.from_item_and_call(item, call)
    participants = sys.modules.get("tests.support.participants")
    if report.failed and participants is not None:
        report.sections.append(("What participants do not agree about", participants.differences()))
    return report


@pytest.fixture(scope="session", autouse=True)
def _own_control_sockets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Bridges that others run on this machine are not the tests' business, nor theirs the others'; nor their files."""

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        patch.setenv("RSB_CONSOLE_ISOLATED", "1")
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        nobodys = tmp_path_factory.mktemp("nobody")
        replaced.FALLBACK_FOLDER.set(patch, lambda: nobodys / "rsb-console")
        constants.SERVICES_SOCKETS.set(patch, nobodys / "services")
        yield


@pytest.fixture(scope="session")
def _domains() -> int:
    """The first of two domains that no other run on this machine uses."""
    return domains_of("engines")


@pytest.fixture
def spare_domains() -> int:
    """The first of two domains for programs that end with the test."""
    return domains_of("programs")


@pytest.fixture(scope="session")
def _robot_domain(_domains: int) -> Iterator[Domain]:
    yield from _domain(_domains)


@pytest.fixture(scope="session")
def _pc_domain(_domains: int) -> Iterator[Domain]:
    yield from _domain(_domains + 1)


def _domain(domain_id: int) -> Iterator[Domain]:
    from tests.support.domain import Domain

    with closing(Domain(domain_id)) as domain:
        yield domain


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
def third() -> Iterator[Domain]:
    """A third domain."""
    yield from _domain(domains_of("programs"))


@pytest.fixture
def bridge(tmp_path: Path, robot: Domain, pc: Domain) -> Iterator[Bridge]:
    """Makes engines, and stops them at the end."""
    from tests.support.bridge import Bridge

    with closing(Bridge(tmp_path, robot, pc)) as made:
        yield made


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

    with closing(Programs(bridge.folder)) as made:
        yield made


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Let references alone free what is freed."""
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    """Serves engines on control sockets of the test's own, and attaches to them."""
    from tests.support.control import Machine

    with closing(Machine(tmp_path)) as made:
        yield made
