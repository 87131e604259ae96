"""The commands ``record list``, ``record get``, ``record missing`` and ``record cancel``."""

from __future__ import annotations

import re
import sys
import time
from datetime import datetime
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import asdict

from rsb_bridge.feature_api import EngineError, Wording, one_line
from rsb_bridge.model.verdict import duration
from rsb_console.feature_console import (
    FAILURE,
    OK,
    UsageError,
    attached,
    done,
    json_line,
    print_error,
    print_line,
    print_problems,
    problems_of,
    redraw_line,
    result,
    side_of,
    table_lines,
)
from rsb_console.notation.formats import byte_count
from rsb_extras.courier.completed_text import completed_lines
from rsb_extras.courier.courier_records import LATEST, called, has_date
from rsb_extras.courier.courier_requests import (
    LISTED_WITHIN,
    CancelFetch,
    FetchRecording,
    FetchState,
    ListFetches,
    ListRecordings,
    ReadCompleted,
)
from rsb_extras.recording.record_command import record as record_last

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.courier.courier_records import ListedRecording
    from rsb_extras.courier.courier_requests import FetchReport, RecordingGroup

HEADINGS = "RECORDING", "SIDE", "BEGIN", "SPAN", "SIZE", "CAUSE", "TOPICS"
_EVERY = 0.5  # s between two looks at a fetch
_BAR = 20  # cells
NOTHING = "-"
_TIME = "%Y-%m-%dT%H:%M:%S"


class CourierCommandText(Wording):
    ALONE = "without list, get, missing or cancel, record takes no {what}"
    LIST_WORDS = "record list: give one link at most"
    GET_WORDS = "record get: give a link and a recording, as `rsb-console record list` prints them"
    MISSING_WORDS = "record missing: give one recording of this side, as `rsb-console record list` prints it"
    CANCEL_WORDS = "record cancel: give the name of one fetch"
    GET_ONLY = "record {action} takes no {option}"
    WITH = "--with names what --complete completes: give both"
    TIME = "{option} {value}: give seconds (12.5, or -30 before the end) or a time (2026-07-30T10:15:00)"
    EMPTY = "--to is before --from"
    NO_SPAN = "{name} does not say when it begins: leave out --from and --to"
    NONE = "neither side has recordings"
    BEGUN = "{name}: the bridge gets it; `rsb-console record list` tells how far it is"
    ASKED = (
        "{link} has not listed its recordings within {seconds:.0f} s: the bridge goes on asking, and gets {name} then; "
        "`rsb-console record list` tells how far it is"
    )
    GOES_ON = "{name}: the bridge goes on; `rsb-console record cancel {name}` gives it up"
    DONE = "{messages:,} messages, {size} crossed: {path}"
    DONE_THERE = "{messages:,} messages, {size} crossed: {path} on the bridge's machine"
    DAMAGED = "{text}; the rest could not be read: {damage}"
    FAILED = "{name}: {reason}"
    GONE = "{name}: the bridge knows nothing of it any more: look at `rsb-console record list`"
    CANCELLED = "{name} is given up"
    FETCH = "{name} of {side}: {text}"
    PROGRESS = "{share:3.0%}, {size}"
    RATE = "{rate}/s"
    REST = "{rest} left"


def record(arguments: Namespace) -> int:
    """Write the last seconds, or do with recordings what `action` says."""
    action = arguments.action
    options = {
        "--from": arguments.begin,
        "--to": arguments.end,
        "--complete": arguments.complete or None,
        "--with": arguments.live,
        "--no-wait": arguments.no_wait or None,
    }
    given = [option for option, value in options.items() if value is not None]
    if action is None:
        if given or arguments.words:
            raise UsageError(CourierCommandText.ALONE(what=given[0] if given else one_line(arguments.words[0])))
        return record_last(arguments)
    given = [*(given if action != "get" else ()), *_of_last(arguments)]
    if given:
        raise UsageError(CourierCommandText.GET_ONLY(action=action, option=given[0]))
    return {"list": _list, "get": _get, "missing": _missing, "cancel": _cancel}[action](arguments)


def _of_last(arguments: Namespace) -> Iterator[str]:
    for option in ("seconds", "output"):
        if getattr(arguments, option) is not None:
            yield f"--{option}"


def _list(arguments: Namespace) -> int:
    if len(arguments.words) > 1:
        raise UsageError(CourierCommandText.LIST_WORDS())
    link = arguments.words[0] if arguments.words else ""
    with attached(arguments) as engine:
        groups = engine.do(ListRecordings(link)).result(LISTED_WITHIN)
        fetches = result(engine.do(ListFetches(link)))
        role = engine.bridge.role
    problems = problems_of(groups, link)
    if arguments.json:
        listed = [{"link": group.link} | _as_data(each) for group in groups for each in newest_first(group)]
        return done(arguments, recordings=listed, fetches=[*map(_fetch_data, fetches)], problems=problems)
    rows = [(each.name, side_of(role, group.link), *texts_of(each)) for group in groups for each in newest_first(group)]
    for line in table_lines(HEADINGS, rows) if rows else ([] if problems else [CourierCommandText.NONE()]):
        print_line(line)
    for fetch in fetches:
        side = side_of(role, fetch.link)
        print_line(CourierCommandText.FETCH(name=fetch.name, side=side, text=fetch_text(fetch)))
    print_problems(role, problems)
    return OK


def _as_data(listed: ListedRecording) -> dict[str, object]:
    topics = [{"name": each.name, "type": each.type_name, "messages": each.messages} for each in listed.topics]
    return asdict(listed) | {"topics": topics}


def _fetch_data(fetch: FetchReport) -> dict[str, object]:
    return asdict(fetch) | {"completed": msgspec.to_builtins(fetch.completed)}


def newest_first(group: RecordingGroup) -> list[ListedRecording]:
    return sorted(group.recordings, key=lambda each: (each.begin, each.name), reverse=True)


def texts_of(listed: ListedRecording) -> tuple[str, str, str, str, str]:
    """Return the begin, span, size, cause and number of topics of a recording, in words."""
    begin = datetime.fromtimestamp(listed.begin / 1e9).strftime(_TIME) if has_date(listed.begin) else NOTHING
    span = duration((listed.end - listed.begin) / 1e9) if listed.end > listed.begin else NOTHING
    topics = len(listed.topics) + listed.more_topics
    return begin, span, byte_count(listed.size), listed.cause or NOTHING, f"{topics}" if topics else NOTHING


def fetch_text(fetch: FetchReport) -> str:
    """Return how a fetch goes, in words."""
    if fetch.state is FetchState.DONE:
        return done_text(fetch, CourierCommandText.DONE)
    if fetch.state is FetchState.FAILED:
        return fetch.reason
    progress = CourierCommandText.PROGRESS(share=fetch.share, size=byte_count(fetch.taken))
    return ", ".join([progress, *pace_texts(fetch), fetch.reason or fetch.state])


def pace_texts(fetch: FetchReport) -> Iterator[str]:
    """Yield a fetch's rate and the time that is left, as far as they are known."""
    if fetch.rate:
        yield CourierCommandText.RATE(rate=byte_count(round(fetch.rate)))
    if fetch.rest is not None:
        yield CourierCommandText.REST(rest=duration(fetch.rest))


def done_text(fetch: FetchReport, wording: CourierCommandText) -> str:
    text = wording(messages=fetch.messages, size=byte_count(fetch.taken), path=fetch.path)
    return CourierCommandText.DAMAGED(text=text, damage=fetch.reason) if fetch.reason else text


def _get(arguments: Namespace) -> int:
    if len(arguments.words) < 2:
        raise UsageError(CourierCommandText.GET_WORDS())
    link, name, *topics = arguments.words
    begin, end = _time_of("--from", arguments.begin), _time_of("--to", arguments.end)
    if arguments.live is not None and not arguments.complete:
        raise UsageError(CourierCommandText.WITH())
    with attached(arguments) as engine:
        first, last = 0, LATEST
        if begin is not None or end is not None:
            listed = _listed(engine, link, name)
            first = 0 if begin is None else begin(listed)
            last = LATEST if end is None else end(listed)
            if last < first:
                raise UsageError(CourierCommandText.EMPTY())
        asked = FetchRecording(link, name, tuple(topics), first, last, arguments.complete, arguments.live or "")
        try:
            fetch = engine.do(asked).result(LISTED_WITHIN)
        except TimeoutError:
            text = CourierCommandText.ASKED(link=one_line(link), name=one_line(name), seconds=LISTED_WITHIN)
            raise EngineError(text) from None
        if arguments.no_wait:
            return done(arguments, CourierCommandText.BEGUN(name=fetch), fetch=fetch)
        return _wait(engine, arguments, fetch)


def _listed(engine: RemoteEngine, link: str, name: str) -> ListedRecording:
    """Return the recording whose begin and end times are meant by seconds, if there is one by that name."""
    groups = engine.do(ListRecordings(link)).result(LISTED_WITHIN)
    found = called(name, (each for group in groups for each in group.recordings))
    if groups and groups[0].problem:
        raise EngineError(groups[0].problem)
    if len(found) != 1 or not found[0].begin:
        raise UsageError(CourierCommandText.NO_SPAN(name=one_line(name)))
    return found[0]


def _time_of(option: str, text: str | None) -> Callable[[ListedRecording], int] | None:
    """Return what makes a time (ns since the epoch) of an option for a recording, or None if it is not given."""
    if text is None:
        return None
    if re.fullmatch(r"[+-]?[0-9]{1,9}(\.[0-9]{1,9})?", text):
        offset = round(float(text) * 1e9)
        return lambda listed: min(max(0, (listed.end if text.startswith("-") else listed.begin) + offset), LATEST)
    try:
        moment = round(datetime.fromisoformat(text).timestamp() * 1e9)
    except (ValueError, OverflowError, OSError):
        raise UsageError(CourierCommandText.TIME(option=option, value=one_line(text))) from None
    return lambda _: min(max(0, moment), LATEST)


def _wait(engine: RemoteEngine, arguments: Namespace, name: str) -> int:
    """Show a fetch until it is over; Ctrl-C leaves it to the bridge."""
    has_bar = sys.stdout.isatty() and not arguments.json
    try:
        while True:
            fetch = next((each for each in result(engine.do(ListFetches())) if each.name == name), None)
            if fetch is None:
                raise EngineError(CourierCommandText.GONE(name=one_line(name)))
            if fetch.is_over:
                break
            if has_bar:
                redraw_line(bar_text(fetch))
            time.sleep(_EVERY)
    except (KeyboardInterrupt, TimeoutError):
        if has_bar:
            redraw_line("")
        print_error(CourierCommandText.GOES_ON(name=name))
        raise
    if has_bar:
        redraw_line("")
    return _tell(engine, arguments, fetch)


def bar_text(fetch: FetchReport) -> str:
    return f"{progress_bar(fetch, _BAR)} {fetch_text(fetch)}"


def progress_bar(fetch: FetchReport, cells: int) -> str:
    """Return a bar, which is full only once all has come."""
    full = int(fetch.share * cells)
    return f"[{'#' * full}{'.' * (cells - full)}]"


def _tell(engine: RemoteEngine, arguments: Namespace, fetch: FetchReport) -> int:
    is_done = fetch.state is FetchState.DONE
    if arguments.json:
        print_line(json_line({"ok": is_done} | ({} if is_done else {"error": fetch.reason}) | _fetch_data(fetch)))
    elif is_done:
        text = CourierCommandText.DONE if engine.trusted else CourierCommandText.DONE_THERE
        print_line(done_text(fetch, text))
        if fetch.completed is not None:
            for line in completed_lines(fetch.completed):
                print_line(line)
    else:
        print_error(CourierCommandText.FAILED(name=fetch.name, reason=fetch.reason))
    return OK if is_done else FAILURE


def _missing(arguments: Namespace) -> int:
    if len(arguments.words) != 1:
        raise UsageError(CourierCommandText.MISSING_WORDS())
    with attached(arguments) as engine:
        completed = result(engine.do(ReadCompleted(arguments.words[0])))
    return done(arguments, *completed_lines(completed), completed=msgspec.to_builtins(completed))


def _cancel(arguments: Namespace) -> int:
    if len(arguments.words) != 1:
        raise UsageError(CourierCommandText.CANCEL_WORDS())
    with attached(arguments) as engine:
        result(engine.do(CancelFetch(arguments.words[0])))
    return done(arguments, CourierCommandText.CANCELLED(name=one_line(arguments.words[0])))
