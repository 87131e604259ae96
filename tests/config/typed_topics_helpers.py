"""Helpers of `test_typed_topics` and others."""

from __future__ import annotations

import math
from typing import Any, get_args

from hypothesis import strategies as st

from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.keys import generate
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.session import RANKS, Direction
from rsb_bridge.model.topic_keys import CORE_KEYS
from rsb_bridge.model.transports import Protocol

KEY = generate().decode()


PARTS = ("a", "scan", "_hidden", "_action", "*", "**", "a*", "1a", "", "rsb", "ä", "a b", "\0", "\n", "a" * 250, KEY)


TYPES = ("auto", "LaserScan", "Twist", "a/msg/B", "a/srv/B", "a/action/B", "a/B", "", "a/../B", KEY, f"a/{KEY}")


QOS: tuple[Any, ...] = (
    "auto", "latched", "lached", 5, -1, 10**9, KEY, {}, {"depth": 0}, {"depth": "5"}, {"profile": "latched"},
    {"profile": "lached"}, {"profile": []}, {"reliability": "reliable"}, {"reliability": KEY}, {"rate": 5},
    {"deadline": 1e-9}, {"deadline": None, "lifespan": math.inf}, {"depth": True},
)  # fmt: skip


ENDS = ("zero", "none", "cancel", "stop", "{linear: {x: 0.1}}", '{"linear": {"x": 0.1}}', "{", "{}", KEY, "{" * 5000)


paths = st.lists(st.sampled_from(PARTS), min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))


names = st.sampled_from(["/scan", "/a/b", "/camera/**"]) | paths | st.text(max_size=8)


numbers = st.none() | st.sampled_from([0.0, 1.0, 5.0, -1.0, 1e-9, 1e12, math.inf, math.nan])


FIELDS: dict[str, st.SearchStrategy[Any]] = {
    **{name: st.booleans() for name, key in CORE_KEYS.items() if key.value == "switch"},
    **{name: st.none() | st.booleans() for name, key in CORE_KEYS.items() if key.value == "choice"},
    **{name: numbers for name, key in CORE_KEYS.items() if key.value == "number"},
    "topic": names,
    "direction": st.sampled_from(get_args(Direction)),
    "type": st.sampled_from(TYPES) | st.text(max_size=8),
    "protocol": st.none() | st.sampled_from(get_args(Protocol)),
    "port": st.none() | st.integers(-1, 70_000) | st.sampled_from([1, 30]),
    "qos": st.sampled_from(QOS),
    "remote_topic": st.none() | names,
    "compression": st.none() | st.sampled_from(["none", "zstd"]),
    "on_end": st.none() | st.sampled_from(ENDS) | st.text(max_size=8),
    "limits": st.none() | st.builds(VelocityLimits, numbers, numbers),
    "beat": st.none() | st.sampled_from(["front", "", KEY, "a\nb", "a" * 300]),
    "keep": numbers | st.builds(Keep, numbers.filter(lambda number: number is not None), numbers),
    "kind": st.sampled_from(list(LISTS)),
    "priority": st.sampled_from(list(RANKS)),
    "excepts": st.lists(names, max_size=3).map(tuple) | st.just(("/a",) * 101),
}
