"""Rights and keys of features with types or names that do not fit: they end no command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
from tests.support import replaced

from rsb_bridge.config.decoding import read
from rsb_bridge.feature import MAY, Feature, PeerRight
from rsb_bridge.installed_features import feature_faults
from rsb_bridge.model.session import session_keys

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pytest


class _Wrong(Feature):
    name = "wrong"

    def rights(self) -> Iterable[PeerRight[Any]]:
        return (
            PeerRight("a-b", bool, default=False),
            PeerRight("shared", tuple[str, ...], ["x"]),
            PeerRight("hints", bool, default=False),
            PeerRight("fits", bool, default=False),
        )


def test_only_a_right_that_fits_is_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.FEATURES_ASKED.set(monkeypatch, lambda method: (_Wrong(),) if method == "rights" else ())
    may = session_keys.__wrapped__()[MAY]
    assert may.type.__struct_fields__ == ("fits",)
    assert len([fault for fault in feature_faults() if fault.feature == "wrong"]) == 3


class _Named(msgspec.Struct):
    counts: dict[str, int | None] = {}


def test_a_mapping_to_several_types_is_read() -> None:
    problems: list[Any] = []
    assert read({"counts": {"a": 1, "b": None}}, _Named, problems).counts == {"a": 1, "b": None}
    assert not problems
    read({"counts": {"a": "x"}}, _Named, problems)
    assert [each.location for each in problems] == ["counts"]
