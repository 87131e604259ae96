"""The table of the keys that an entry for a topic, a service, an action or a node's parameters may have.

`rsb_bridge.model.session.Topic` has a field for each key, and `features` for those of features. The table has what the
rules of session files, the console's form, the command line, proposals and the wire need to know about it. Rules about
several keys are in `rsb_bridge.config.topic_rules`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from rsb_bridge.installed_features import added_by, guarded, leave_out
from rsb_bridge.model.limits import FEATURE_VALUES, RATE, Range
from rsb_bridge.model.qos import PROFILES
from rsb_bridge.model.session import CALL_TIMEOUT, DEADMAN, Kind, Topic
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from rsb_bridge.feature import EntryKey

Value = Literal["text", "number", "switch", "choice", "list"]  # a choice is on, off or open

STALE_AFTER = Range(0.1, 1e6)
"""s: the engine looks at a route every quarter of a second at most; the longest is eleven days."""
LATE_AFTER = Range(0.05, 1e6)  # s; a smaller bound would be within the uncertainty of the other side's clock
MAX_AGE = Range(0.05, 3600)
"""s: a smaller bound would be within the uncertainty of the other side's clock; an hour old is no command any more."""
DEADMAN_TIME = Range(2, 86_400)  # s: the other side hears of pressed keys once a second; the longest is a day
CALL_TIME = Range(0.1, 86_400)
"""s: until a call is given up. Shorter ones are over before a slow link has answered; the longest is a day."""


class ForeignKey(Wording):
    """A key that entries of another kind or other installations have, and this one does not."""

    KIND_OF_TOPIC = "not a key: services, actions and parameters have lists of their own"
    KIND_OF_CALLED = "not a key: the list defines the kind; leave it out"
    TIMEOUT_OF_TOPIC = "a topic has no timeout: leave it out; services and actions have lists of their own"
    PROVIDER_OF_TOPIC = "a topic has a direction, transmit or receive; services and actions have lists of their own"
    NOT_A_TOPIC = "not a topic: list it under {list}"
    PRIORITY_OF_CALLED = "calls go ahead of all topics: leave it out"
    QOS_OF_CALLED = "calls have ROS's own QoS: leave it out"
    EXPECTED_RATE_OF_CALLED = "calls have no expected rate: leave it out"
    STALE_AFTER_OF_CALLED = (
        "calls do not become stale: leave it out; timeout limits how long a call waits for its answer"
    )
    OF_TOPICS_ONLY = "only topics have it: leave it out"
    OF_CALLS_ONLY = "topics do not have it: leave it out"
    LATE_AFTER_OF_CALLED = "only topics have it: leave it out; timeout limits how long a call waits for its answer"
    KEEP_OF_CALLED = "only topics have it, and calls wait for the link without it: leave it out"
    DIRECTION_OF_CALLED = "write provider: client or provider: server, the side whose node answers"
    LIST_UNDER = "list this entry under {list}, or write {key}: /..."
    OTHER_REMOTE = "write {key}"
    TYPE_OF_PARAMETERS = "parameters have types of ROS's own: leave it out"


class RangeText(Wording):
    """The values that a key may have."""

    DEADMAN = "{range} s, or 0 for none"
    LATE_AFTER = "{range} s, or 0 to accept any delay"
    MAX_AGE = "{range} s, or none for no limit"
    STALE_AFTER = "{range} s, or 0 to never warn"
    RATE = "{range} Hz, or leave it out"
    TIMEOUT = "{range} s, or leave it out"
    OF_FEATURE = "{range}, or leave it out"


@dataclass(frozen=True, slots=True)
class TopicKey:
    """A key of an entry in a session."""

    name: str  # the field of `rsb_bridge.model.session.Topic`
    value: Value = "text"  # what an operator gives for it
    kinds: Literal["all", "topics", "calls"] = "all"  # the entries that may have it
    limits: Range | None = None
    """The range of a number, or None if other rules apply; `range_text` tells it to an operator."""
    range_text: RangeText | None = None
    unit: str = ""
    zero: bool = False  # whether 0 is allowed, too
    zero_word: str = ""  # a word that an operator may give for 0, or empty
    sentence: str = ""  # the key with its value, for a person; `zero_sentence` if that is 0
    zero_sentence: str = ""
    live: bool = False  # whether a change leaves the route open
    label: str = ""  # of its field in the form, or empty if the form makes the field itself
    help: str = ""  # the form's help for a topic, and `help_of_calls` if that differs for other kinds
    help_of_calls: str = ""
    blank: str = ""  # the meaning of an empty field, a template with the session
    options: tuple[tuple[str, str], ...] = ()  # the choices of its field, each a value and a label

    def is_of(self, kind: Kind) -> bool:
        if kind == "parameters" and self.name == "type":
            return False  # ROS's own
        return self.kinds == "all" or (self.kinds == "topics") == (kind == "topic")

    def allows(self, value: float) -> bool:
        """Whether a number is in the key's range, or 0 where that is allowed."""
        return self.limits is None or value in self.limits or (self.zero and value == 0)

    def help_of(self, kind: Kind) -> str:
        return (kind != "topic" and self.help_of_calls) or self.help

    def described(self, value: Any, kind: Kind) -> str:
        """Return the key with its value, for a person: ``at most 5 Hz``."""
        unit = "calls/s" if kind != "topic" and self.unit == "Hz" else self.unit
        return self.sentence.format(value=value, unit=unit) if value or not self.zero else self.zero_sentence


_SWITCH = (("", "no"), ("yes", "yes"))
_OPEN = (("", "as the profile says"), ("yes", "yes"), ("no", "no"))
_PRIORITIES = (("", "normal"), ("high", "high"), ("low", "low"))
_OLD = "Seconds; an older {} none: no limit. Empty: 1 s if it has to be armed, else no limit."
_KNOWN_QOS = f"auto, {', '.join(PROFILES)}, a depth (20), or policies: {{reliability: best_effort}}"

CORE_KEYS: Final = {key.name: key for key in (
    TopicKey("topic"),
    TopicKey("direction"),
    TopicKey("excepts", "list", label="Except", blank="nothing",
             help="For a pattern (/camera/**): names and patterns on the client that it leaves out, "
                  "separated by blanks."),
    TopicKey("type"),
    TopicKey("qos", kinds="topics",
             label="QoS", help=_KNOWN_QOS, blank="auto"),
    TopicKey("remote_topic"),
    TopicKey("timeout", "number", kinds="calls",
             limits=CALL_TIME, range_text=RangeText.TIMEOUT, unit="s",
             label="Timeout", help="Seconds without an answer until a call is given up.", blank=f"{CALL_TIMEOUT:g} s"),
    TopicKey("protocol"),
    TopicKey("port", "number"),
    TopicKey("max_rate", "number", limits=RATE, range_text=RangeText.RATE, unit="Hz", live=True,
             sentence="at most {value:g} {unit}",
             label="Max rate", help="Hz; messages beyond it are left out. Empty: no limit.", blank="all",
             help_of_calls="Calls a second; those beyond it are refused. Empty: no limit."),
    TopicKey("beat", kinds="topics", live=True, sentence="in beat {value}",
             label="Beat", help="A name that topics share whose messages of one stamp pass their max rate together.",
             blank="none; of a pattern its own"),
    TopicKey("priority", kinds="topics", live=True,
             sentence="{value} priority",
             label="Priority", help="While the link is full, topics of higher priority get a larger share of it.",
             options=_PRIORITIES),
    TopicKey("expected_rate", "number", kinds="topics",
             limits=RATE, range_text=RangeText.RATE, unit="Hz", live=True, sentence="expected {value:g} {unit}",
             label="Expected rate", help="Hz, shown with the measured rate. Empty: learned.", blank="learned"),
    TopicKey("stale_after", "number", kinds="topics",
             limits=STALE_AFTER, range_text=RangeText.STALE_AFTER, zero=True, unit="s", live=True,
             sentence="stale after {value:g} {unit}", zero_sentence="never stale",
             label="Stale after", help="Seconds without a message before a warning, or 0 to never warn.",
             blank="{session.stale_after:g} s"),
    TopicKey("late_after", "number", kinds="topics",
             limits=LATE_AFTER, range_text=RangeText.LATE_AFTER, zero=True, unit="s", live=True,
             sentence="late after {value:g} {unit}", zero_sentence="never late",
             label="Late after", help="Seconds that a message may take before a warning, or 0 to never warn.",
             blank="{session.late_after:g} s"),
    TopicKey("max_age", "number", limits=MAX_AGE, range_text=RangeText.MAX_AGE, zero=True, zero_word="none", unit="s",
             live=True,
             sentence="dropped if older than {value:g} {unit}", zero_sentence="of any age",
             label="Max age", help=_OLD.format("message is dropped."), blank="1 s if armed, 0.5 s of commands",
             help_of_calls=_OLD.format("request is refused.")),
    TopicKey("keep", kinds="topics", live=True,
             label="Keep", help="Seconds of which all messages wait for a link that is away or too slow: 60, or "
                                "{seconds: 60, megabytes: 8}.",
             blank="what the QoS keeps"),
    TopicKey("lazy", "choice", kinds="topics", live=True, sentence="lazy", zero=True, zero_sentence="never rests",
             label="Lazy", help="Subscribed to only while somebody on the other side subscribes.", options=_OPEN),
    TopicKey("renew", "switch", kinds="topics", live=True, sentence="renewed for each subscriber",
             label="Renew", help="Subscribes once more for each subscriber on the other side, for publishers that "
                                 "send all to a new subscriber.", options=_SWITCH),
    TopicKey("express", "switch", kinds="topics", sentence="express",
             label="Express", help="Its messages are sent at once. Those of other topics wait for each other, "
                                   "up to 4 ms.", options=_SWITCH),
    TopicKey("compression"),
    TopicKey("arm", "switch",
             label="Must be armed", help="Carries nothing until an operator arms it (key A).", options=_SWITCH),
    TopicKey("deadman", "number", limits=DEADMAN_TIME, range_text=RangeText.DEADMAN, zero=True, unit="s",
             label="Deadman", help="Seconds without a key on the console that armed it, then it disarms. 0 for never.",
             blank=f"{DEADMAN:g} s, if it has to be armed"),
    TopicKey("on_end", sentence="ends with {value}",
             label="On end", help="What the robot gets once disarmed: zero, none, or a message: {linear: {x: 0}}.",
             help_of_calls="cancel: once disarmed, an action's goals of the callers over the link are cancelled.",
             blank="zero, if the type drives robots; of an action none"),
    TopicKey("limits", kinds="topics",
             label="Limits", help="What a hand may ask at most, in m/s and rad/s: {linear: 0.5, angular: 1}.",
             blank="any velocity"),
    TopicKey("paused", "switch",
             label="Paused", help="Set up, but carries nothing until resumed.", options=_SWITCH),
)}  # fmt: skip
"""The core's keys by the fields' names, in the order in which an operator thinks of them: of form and command line.

`kind` is no key: the list defines it.
"""
_IN_FILES = ("service", "action", "node", "provider", "remote_service", "remote_action", "remote_node", "except")
"""The names of some fields in files."""


def _of_features() -> Iterator[tuple[EntryKey[Any], TopicKey]]:
    taken, of_both = (*Topic.__struct_fields__, *_IN_FILES), 0
    for feature, key in added_by("topic_keys", name_of=lambda key: key.name, taken=taken):
        with guarded(feature, "topic_keys"):
            shown = _shown(key)
            if key.of_peer and of_both == FEATURE_VALUES:
                text = f"{key.name}: the other side gets at most {FEATURE_VALUES} keys of features: remove a feature"
                leave_out(feature.name, "topic_keys", text)
                continue
            of_both += key.of_peer
            yield key, shown


def _shown(key: EntryKey[Any]) -> TopicKey:
    values: dict[Any, Value] = {float: "number", str: "text", bool: "switch"}
    if key.type not in values:
        raise TypeError(f"the type of {key.name} is {key.type}, and not float, str or bool")
    return TopicKey(
        key.name,
        values[key.type],
        key.kinds,
        limits=None if key.limits is None else Range(*key.limits),
        range_text=RangeText.OF_FEATURE,
        unit=key.unit,
        sentence=key.name if key.type is bool else f"{key.name} {{value}} {{unit}}".rstrip(),
        label=key.label,
        help=key.help,
        blank="" if key.default is None else str(key.default),
        options=_SWITCH if key.type is bool else (),
    )


_ADDED = tuple(_of_features())
ADDED_KEYS: Final = {key.name: key for key, _ in _ADDED}
"""The features' keys."""
TOPIC_KEYS: Final = CORE_KEYS | {shown.name: shown for _, shown in _ADDED}
"""All keys, those of features by their names in `Topic.features`."""


def value_of(topic: Topic, name: str) -> Any:
    """Return the value of a key in an entry, the core's or a feature's."""
    return ADDED_KEYS[name].of(topic) if name in ADDED_KEYS else getattr(topic, name)


def type_of(key: EntryKey[Any]) -> Any:
    """Return the type of a feature's key in an entry that may lack it."""
    return key.type | None if key.default is None else key.type


def without_defaults(features: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of features' keys that differ from their defaults, as `Topic.features` has them."""
    return {name: value for name, value in features.items() if value != ADDED_KEYS[name].default}


def of_peer(features: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of those features' keys that the other side gets, too."""
    return {name: value for name, value in features.items() if _is_of_peer(name)}


def of_this_side(features: Mapping[str, Any]) -> dict[str, Any]:
    """Return the others."""
    return {name: value for name, value in features.items() if not _is_of_peer(name)}


def _is_of_peer(name: str) -> bool:
    return name in ADDED_KEYS and ADDED_KEYS[name].of_peer


def keys_of_value(value: Value) -> tuple[str, ...]:
    """Return the names of the keys with such values."""
    return tuple(name for name, key in TOPIC_KEYS.items() if key.value == value)
