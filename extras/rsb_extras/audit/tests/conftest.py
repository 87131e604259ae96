"""A pair of recordings, and the command that compares them."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from tests.command.conftest import here, ran

from rsb_extras.audit.tests.written import Written

__all__ = ["here", "ran"]


class Sides(NamedTuple):
    near: Written
    far: Written

    def topic(self, name: str, **qos: Any) -> str:
        for side in self:
            side.topic(name, **qos)
        return name

    def stream(
        self,
        near: str,
        far: str = "",
        *,
        age: float = 0.02,
        tail: float = 0.0,
        lost: Collection[int] = (),
        back: bool = False,
    ) -> None:
        """Send a message each 0.1 s, from 2 s to 12 s, from NEAR to FAR or `back`. Each tenth is later by `tail` s."""
        source, sink = ((self.near, near), (self.far, far or near))[:: -1 if back else 1]
        for number in range(100):
            at = 2 + number * 0.1
            source[0].add(source[1], at, number)
            if number not in lost:
                sink[0].add(sink[1], at + age + number % 10 * 0.001 + (tail if number % 10 == 9 else 0.0), number)

    def spans(self, end: float) -> None:
        for side in self:
            side.spans(end)


@dataclass(frozen=True)
class Audited:
    """A result of the command: its exit code, and what ``--json`` prints."""

    code: int
    json: Any

    def __getitem__(self, topic: Any) -> Any:
        return next(each for each in self.json["topics"] if each["topic"] == topic)

    @property
    def breaches(self) -> set[tuple[str, str, int]]:
        return {(each["kind"], each["name"], each["count"]) for each in self.json["breaches"]}


@pytest.fixture
def ahead() -> float:
    """s that FAR's clock is ahead of NEAR's."""
    return 0.0


@pytest.fixture
def sides(tmp_path: Path, ahead: float) -> Iterator[Sides]:
    made = Sides(Written(tmp_path / "near.mcap"), Written(tmp_path / "far.mcap", ahead))
    yield made
    for side in made:
        side.file.close()


@pytest.fixture
def audited(sides: Sides, ran: Any) -> Callable[..., Audited]:
    """End both recordings and compare them."""

    def run(*options: str, near: Path | None = None, far: Path | None = None) -> Audited:
        if near is None:
            sides.near.done()
        if far is None:
            sides.far.done()
        done = ran("audit", str(near or sides.near.path), str(far or sides.far.path), *options, "--json")
        assert done.err == ""
        return Audited(done.code, json.loads(done.out))

    return run
