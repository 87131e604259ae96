"""Layouts: sets of tiles that console.yaml names.

::

    layouts:
      drive: [/camera/image_raw, /map, rates, log]
      arm:
        robots: ["arm*"]
        tiles:
          - /camera/image_raw
          - {topic: /joint_states, as: plot, fields: ["position[elbow]"], seconds: 60}
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import ConsoleSetting
from rsb_console.notation.console_setting import placed
from rsb_extras.pictures.picture import MOST_RATE, TOPICS_AT_ONCE, Wish

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rsb_console.feature_console import Console

_Name = Annotated[str, Meta(min_length=1, max_length=255)]


class LayoutText(Wording):
    NO_MAPPING = "layouts: give names with lists of tiles, like drive: [/camera/image_raw, /map, rates]"
    NO_TILES = "layouts.{name}: give a list of topics and other tiles, or a mapping with robots and tiles"
    NO_TOPIC = "layouts.{name}.tiles[{at}]: give a topic, or topics"


class Subject(NamedTuple):
    """What a tile shows.

    Attributes:
        topics: the topics, the first of which gives the kind of picture; or only the name of a tile without a topic.
        link: the link to the side that publishes them, or an empty string if the engine is to find the side.
        type_name: of the first topic, or empty if it is unknown.
        layers: further topics of that side that can be laid over a map.
        wish: how to draw it at first.
    """

    topics: tuple[str, ...]
    link: str = ""
    type_name: str = ""
    layers: tuple[str, ...] = ()
    wish: Wish = Wish()


_AS_WRITTEN = {"how": "as"}


class _Entry(msgspec.Struct, forbid_unknown_fields=True, rename=_AS_WRITTEN):
    """A tile in the file; its keys are those of the command ``look``."""

    topic: _Name | None = None
    topics: Annotated[tuple[_Name, ...], Meta(max_length=TOPICS_AT_ONCE)] = ()
    link: str = ""
    how: Annotated[str, Meta(max_length=16)] = ""
    fields: Annotated[tuple[_Name, ...], Meta(max_length=8)] = ()
    seconds: Annotated[float, Meta(ge=1, le=3600)] = 30.0
    rate: Annotated[float, Meta(gt=0, le=MOST_RATE)] = 2.0
    zoom: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0
    tilt: Annotated[float, Meta(ge=0, le=90)] = 0.0
    frame: str = ""
    match: str = ""


_OF_WISH = ("how", "fields", "seconds", "rate", "zoom", "tilt", "frame", "match")


class Layout(NamedTuple):
    """A named set of tiles.

    Attributes:
        robots: patterns of the names of links that it is for, or none for all.
    """

    name: str
    tiles: tuple[Subject, ...]
    robots: tuple[str, ...] = ()

    def suits(self, links: Iterable[str]) -> bool:
        return not self.robots or any(fnmatchcase(link, pattern) for link in links for pattern in self.robots)


def read_layouts(value: object) -> dict[str, Layout]:
    """Return layouts by name.

    Raises:
        ValueError: the reason, which begins with the place of the mistake.
    """
    if not isinstance(value, dict):
        raise ValueError(LayoutText.NO_MAPPING())  # noqa: TRY004 -- the contract of `ConsoleSetting.read`
    return {str(name): _layout(str(name), given) for name, given in value.items()}


def _layout(name: str, given: object) -> Layout:
    robots: object = []
    if isinstance(given, dict) and given.keys() <= {"robots", "tiles"}:
        robots, given = given.get("robots", []), given.get("tiles")
    if not isinstance(given, list) or not given or not isinstance(robots, list):
        raise ValueError(LayoutText.NO_TILES(name=name))
    return Layout(name, tuple(_subject(name, at, each) for at, each in enumerate(given)), tuple(map(str, robots)))


def _subject(name: str, at: int, given: object) -> Subject:
    if isinstance(given, str) and given:
        return Subject((given,))
    try:
        entry = msgspec.convert(given, _Entry)
    except msgspec.ValidationError as error:
        raise ValueError(placed(f"layouts.{name}.tiles[{at}]", error)) from None
    topics = (entry.topic,) if entry.topic is not None else entry.topics
    if not topics:
        raise ValueError(LayoutText.NO_TOPIC(name=name, at=at))
    return Subject(topics, entry.link, wish=Wish(**{each: getattr(entry, each) for each in _OF_WISH}))


LAYOUTS: ConsoleSetting[Mapping[str, Layout]] = ConsoleSetting("layouts", {}, read_layouts)


def written(subject: Subject) -> str | dict[str, Any]:
    """Return a tile as console.yaml has it."""
    topics, wish = subject.topics, subject.wish
    found: dict[str, Any] = {"topics": [*topics]} if len(topics) > 1 else {"topic": topics[0]}
    if subject.link:
        found["link"] = subject.link
    for name in _OF_WISH:
        if (value := getattr(wish, name)) != getattr(Wish(), name):
            found[_AS_WRITTEN.get(name, name)] = [*value] if isinstance(value, tuple) else value
    return topics[0] if found.keys() == {"topic"} else found


def as_written(layout: Layout) -> object:
    """Return a layout as console.yaml has it."""
    tiles = [written(each) for each in layout.tiles]
    return {"robots": list(layout.robots), "tiles": tiles} if layout.robots else tiles


def layouts_for(console: Console) -> list[Layout]:
    """Return the layouts for the robots that are linked."""
    links = [link.name for link in console.snapshot().links]
    return [layout for layout in LAYOUTS.of(console.preferences).values() if layout.suits(links)]
