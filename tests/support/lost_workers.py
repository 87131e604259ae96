"""A pytest plugin: a run that loses a worker of pytest-xdist says so, and another one runs what is left.

pytest-xdist stops then, as the rest of the worker's lane is not run. So such a run says nothing of what it has not run.
"""

from __future__ import annotations

from typing import Any

import pytest

LOST = 20
"""The exit code of such a run; pytest has none of it."""
_PASSED = "lost_workers/passed"
"""Where pytest's cache keeps what such a run has shown."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--left", action="store_true", help="run what a run that lost a worker has left")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Run(config))


class _Run:
    """What the process that prints knows of a run."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._passed: dict[str, bool] = {}
        self._lost = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._passed[report.nodeid] = not report.failed and self._passed.get(report.nodeid, True)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, error: object) -> None:
        self._lost |= error is not None

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        if self._config.getoption("left"):
            node.workerinput["passed"] = self._config.cache.get(_PASSED, [])

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self._lost and session.exitstatus != pytest.ExitCode.INTERRUPTED:
            self._config.cache.set(_PASSED, [nodeid for nodeid, passed in self._passed.items() if passed])
            session.exitstatus = LOST


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    passed = frozenset(getattr(config, "workerinput", {}).get("passed", ()))
    items[:] = [item for item in items if item.nodeid not in passed]
