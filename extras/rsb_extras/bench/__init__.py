"""Bench: measures a machine, or the link of a running bridge, within limits that the other side's session sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.feature_api import Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Bridge, EnginePart, Extension, Link, Purpose
    from rsb_console.feature_console import AddCommand, Complete


class BenchmarkLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Limits on the load that a measuring peer may cause in any hour.

    Attributes:
        seconds: seconds of sending, by the peer or by this side at its request.
    """

    seconds: float = 300.0
    max_rate: float = 20_000.0
    megabytes: float = 4_000.0


LIMITS: SessionKey[BenchmarkLimits | None] = SessionKey("bench", BenchmarkLimits | None, None, live=True, of_peer=True)
"""The limits within which the peer may measure the link, or None if it may not."""


class BenchFeature(Feature):
    name = "bench"
    needs = ("demo", "recording")

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (LIMITS,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.bench import bench_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return bench_rules.problems(session)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.bench import bench_rules  # noqa: PLC0415

        return bench_rules.effects(session)

    def purposes(self) -> Iterable[Purpose]:
        from rsb_extras.bench.benchmark import BENCH  # noqa: PLC0415

        return (BENCH,)

    def messages(self) -> Iterable[type[msgspec.Struct]]:
        from rsb_extras.bench.link_bench import BenchAnswer, BenchAsk  # noqa: PLC0415

        return BenchAsk, BenchAnswer

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.bench.link_bench import LinkBench  # noqa: PLC0415

        return (LinkBench(link, link.table),)

    def commands(self) -> Iterable[type[msgspec.Struct]]:
        from rsb_extras.bench.benchmark import Bench  # noqa: PLC0415

        return (Bench,)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.bench.link_bench import BenchPart  # noqa: PLC0415

        return (BenchPart(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.bench.bench_arguments import add_bench_command  # noqa: PLC0415

        add_bench_command(add, complete)


FEATURE = BenchFeature()
