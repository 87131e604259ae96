"""The field for a change of several robots: operators type the topic, keys and values, or pick what the robots have."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len

from rsb_bridge.config.file_form import KEYS
from rsb_bridge.model.text import join_first, plural
from rsb_console.screens.topic_fields import fields_by_kind
from rsb_console.session.draft import SWITCHES, Ends, values_of
from rsb_console.session.typed_topic import TypedError, typed_topic
from rsb_console.widgets.field_input import FieldInput
from rsb_console.widgets.lines import Line, clip, fit_middle
from rsb_console.widgets.picker import PickField, Suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_console.fleet.rolling import Bridged
    from rsb_console.widgets.form import Spec

_NAME, _COUNT, _RATE, _TYPE = (18, 40), 16, 14, 20
"""Cells of a topic's columns; the name gets the rest of the line, within bounds."""
_KEY, _VALUES = 16, 26
"""Cells of a key, and of its present values."""
_CHECKED = 5
"""Most entries against which a value is checked while it is typed; the plan checks all."""
_FIXED = ("topic", "direction", "kind")
"""Fields whose change makes another topic of it."""


class Typed(NamedTuple):
    """An incomplete change, split at its last word.

    Attributes:
        head: the words before the last one.
        last: the last word, which may be empty.
    """

    head: tuple[str, ...]
    last: str

    @classmethod
    def of(cls, text: str) -> Typed:
        """Take the text of a field apart."""
        head, _, last = text.rpartition(" ")
        return cls(tuple(head.split()), last)

    @property
    def topic(self) -> str:
        """The topic, or an empty string while it is still being typed."""
        return next((word for word in self.head if word.startswith("/")), "")

    @property
    def key(self) -> str:
        """The key whose value is being typed, or an empty string."""
        key, is_pair, _ = self.last.partition("=")
        return key if is_pair and self.topic else ""


def change_of(text: str) -> tuple[str, list[str]] | None:
    """Return the topic and the ``KEY=VALUE`` pairs of a whole change, or None if it is incomplete."""
    words = text.split()
    topics = [word for word in words if word.startswith("/")]
    keys = [word for word in words if "=" in word and not word.startswith("/")]
    whole = len(topics) == 1 and bool(keys) and len(words) == len(keys) + 1
    return (topics[0], keys) if whole else None


class ChangeField(PickField):
    """A line such as ``/camera max_rate=5`` above a list of topics, keys or values that can follow."""

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec, is_literal=self._is_whole)
        self._bridged: dict[str, list[Bridged]] = {}
        self._waiting = True

    # -- the robots' entries ------------------------------------------------------------------------------------------

    def set_bridged(self, bridged: Sequence[Bridged], *, waiting: bool) -> None:
        """Offer the robots' entries.

        Args:
            bridged: all entries so far.
            waiting: whether some have not answered yet.
        """
        self._bridged = {}
        for each in bridged:
            self._bridged.setdefault(each.route.spec.topic, []).append(each)
        self._waiting = waiting
        self.offer()

    def offer(self) -> None:
        """List the suggestions for the next word."""
        typed = self.typed
        if not typed.topic:
            self.suggest(list(self._topics()), lambda _: self._no_topic(typed))
        elif typed.key:
            self.suggest(list(self._values(typed)), lambda _: self._about(typed))
        else:
            empty = f"no key is called {typed.last}" if self._entries(typed) else self._no_topic(typed)
            self.suggest(list(self._keys(typed)), lambda _: empty)

    @property
    def typed(self) -> Typed:
        """The text, split at its last word."""
        return Typed.of(self.control.value)

    def filter_text(self) -> str:
        """The word that narrows the list."""
        typed = self.typed
        if not typed.topic:
            return super().filter_text()
        return typed.last.partition("=")[2] if typed.key else typed.last

    def put(self, suggestion: Suggestion) -> None:
        """Append a picked suggestion to the text."""
        typed = self.typed
        head = " ".join(typed.head) if typed.topic else ""
        value = suggestion.value
        if typed.key:
            value = f"{typed.key}={value}" + ("" if value else " ")  # an empty value is one, too
        assert isinstance(self.control, FieldInput)
        self.control.value = f"{head} {value}".lstrip()
        self.control.cursor_position = len(self.control.value)
        self.offer()

    def mistake(self) -> str:
        """The first mistake in the typed values, or an empty string."""
        if (change := change_of(self.value)) is None:
            return ""
        topic, keys = change
        seen: list[object] = []
        for each in self._bridged.get(topic, ()):
            if each.route.spec in seen:
                continue
            if len(seen) == _CHECKED:
                break
            seen.append(each.route.spec)
            try:
                typed_topic(values_of(each.route.spec), keys, each.session, each.route.spec)
            except TypedError as error:
                return f"{each.robot}: {error}"
        return ""

    def _is_whole(self, text: str) -> bool:
        """Whether enter takes the text; otherwise it picks a suggestion."""
        typed = self.typed
        is_open = typed.last == f"{typed.key}=" and bool(typed.key) and bool(list(self._values(typed)))
        return change_of(text) is not None and not is_open

    def _no_topic(self, typed: Typed) -> str:
        return "asking the robots …" if self._waiting else f"no robot has {typed.topic or 'such a topic'}"

    def _entries(self, typed: Typed) -> list[Bridged]:
        return self._bridged.get(typed.topic, [])

    # -- suggestions --------------------------------------------------------------------------------------------------

    def _topics(self) -> Iterator[Suggestion]:
        robots = {each.robot for entries in self._bridged.values() for each in entries}
        order = sorted(self._bridged.items(), key=lambda item: (-len({each.robot for each in item[1]}), item[0]))
        for topic, entries in order:
            count = len({each.robot for each in entries})
            of_all = f"{count} of {len(robots)} {plural(len(robots), 'robot')}"
            types = sorted({each.route.type_name for each in entries} - {""})
            kinds = sorted({each.route.spec.kind for each in entries} - {"topic"})
            about = " ".join([*kinds, join_first([name.replace("/msg/", "/") for name in types], 1)]).strip()
            rates = [each.route.rate for each in entries if each.route.spec.kind == "topic"]
            rate = f"{min(rates):.1f} Hz" if rates and min(rates) == max(rates) else ""
            if rates and not rate:
                rate = f"{min(rates):.1f}-{max(rates):.1f} Hz"
            yield Suggestion(topic, f"{topic} ", partial(_topic_line, topic, of_all, rate, about))

    def _keys(self, typed: Typed) -> Iterator[Suggestion]:
        entries = self._entries(typed)
        if not entries:
            return
        specs = self._specs(entries)
        taken = {word.partition("=")[0] for word in typed.head}
        for key, field in KEYS[entries[0].route.spec.kind].items():
            if field not in _FIXED and key not in taken:
                spec = specs.get(field)
                about = spec.help if spec is not None else ""
                yield Suggestion(key, f"{key}=", partial(_key_line, key, _now(entries, field, spec), about))

    def _values(self, typed: Typed) -> Iterator[Suggestion]:
        entries = self._entries(typed)
        if not entries:
            return
        field = KEYS[entries[0].route.spec.kind].get(typed.key, "")
        spec = self._specs(entries).get(field)
        for value, label in spec.options if spec is not None else ():
            text = value or ("no" if field in SWITCHES else "")
            yield Suggestion(f"value {text}", text, partial(_value_line, text, label))

    def _about(self, typed: Typed) -> str:
        """Return the meaning of a key and its present values."""
        entries = self._entries(typed)
        if not entries:
            return self._no_topic(typed)
        if not (field := KEYS[entries[0].route.spec.kind].get(typed.key, "")):
            return f"no key is called {typed.key}"
        spec = self._specs(entries).get(field)
        return f"{'' if spec is None else spec.help} Now: {_now(entries, field, spec)}.".strip()

    def _specs(self, entries: Sequence[Bridged]) -> dict[str, Spec]:
        """Return the fields of a topic's form by their names."""
        first = entries[0]
        ends = Ends(first.session.role == "server", first.route.link, use_name=False)
        kind = first.route.spec.kind
        return fields_by_kind(first.session, ends, first.route)[kind]


def _now(entries: Sequence[Bridged], field: str, spec: Spec | None) -> str:
    """Format the present values of a field, with their robots, the most frequent first: ``30 on 2, none on 1``."""
    distinct = dict.fromkeys((each.robot, _value(each, field, spec)) for each in entries)  # a robot may have several
    values = Counter(value for _, value in distinct)
    if len(values) == 1:
        return next(iter(values))
    return join_first([f"{value} on {count}" for value, count in values.most_common()], 3)


def _value(entry: Bridged, field: str, spec: Spec | None) -> str:
    text = values_of(entry.route.spec).get(field, "")
    if field in SWITCHES:
        return "yes" if text else "no"
    if text or spec is None:
        return text or "none"
    return dict(spec.options).get("") or ("auto" if spec.blank == "auto" else "none")


def _topic_line(topic: str, count: str, rate: str, about: str, width: int) -> Line:
    name = min(_NAME[1], max(_NAME[0], width - _COUNT - _RATE - _TYPE))
    return (*_column(topic, name, "strong"), *_column(count, _COUNT, "dim"), *_column(rate, _RATE, ""), (about, "dim"))


def _key_line(key: str, now: str, about: str, _width: int) -> Line:
    if cell_len(now) >= _VALUES:
        now = f"{clip(now, _VALUES - 2).rstrip(', ')}…"  # the most frequent values come first
    return (*_column(key, _KEY, "strong"), *_column(now, _VALUES, ""), (about, "dim"))


def _value_line(value: str, label: str, _width: int) -> Line:
    return (*_column(value, _KEY, "strong"), (label, "dim")) if value else ((label, "strong"),)


def _column(text: str, width: int, look: str) -> Line:
    cut = fit_middle(text, width - 1)
    return (cut, look), (" " * (width - cell_len(cut)), "")
