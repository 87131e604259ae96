"""A topic of what is typed on a command line: ``max_rate=5 compression=zstd``."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

from rsb_bridge.config.file_form import DIRECTIONS, KEYS, field_of, hints_of, key_of
from rsb_console.session.draft import SWITCHES, problems_of, topic_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.model.session import Session, Topic


class TypedError(ValueError):
    """What is typed makes no topic; the message says what would."""


def typed_topic(values: Mapping[str, str], keys: Sequence[str], session: Session, replaced: Topic | None) -> Topic:
    """A topic of the values that it has already and those that are typed.

    Args:
        values: as of `rsb_console.session.draft.values_of`.
        keys: typed, each ``KEY=VALUE``.
        session: what it is for.
        replaced: one of the session's that it takes the place of.

    Raises:
        TypedError: something is wrong with it.
    """
    kind = replaced.kind if replaced is not None else next(kind for kind in KEYS if kind == values["kind"])
    known, changed = list(KEYS[kind]), dict(values)
    for text in keys:
        key, is_pair, value = text.partition("=")
        if not is_pair:
            raise TypedError(f"{text}: not KEY=VALUE, as in max_rate=5")
        if key not in known:
            hint = hints_of(kind).get(key) or f"unknown key{suggestion(key, known)}"
            raise TypedError(f"{text}: {hint} (keys: {', '.join(known)})")
        changed[field_of(kind, key)] = _value(key, value)
    topic = topic_of(changed)
    if problems := problems_of(topic, session, replaced):
        raise TypedError("; ".join(f"{key_of(kind, field)}: {problem}" for field, problem in problems.items()))
    return topic


def _value(key: str, value: str) -> str:
    if key == "provider":
        return DIRECTIONS.get(value, value)
    return "" if key in SWITCHES and value in ("no", "false") else value


def suggestion(name: str, known: Sequence[str]) -> str:
    """A hint at the most similar name; empty: none is similar."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]}?" if near else ""
