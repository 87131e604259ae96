"""Rules on the folders of recordings of a session, and what `check` says of who gets them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Range, Wording, one_line
from rsb_extras.courier import MAY_FETCH, RECORDINGS_KEY
from rsb_extras.recording.record_rules import RecordText

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Session

_MOST_FOLDERS = 16
"""Of a session. A round figure: each is looked through for each list."""

FETCHED_SIZE = Range(0.01, 100_000)
"""GB. Round figures."""


class CourierRulesText(Wording):
    TOO_MANY = "has {count} folders: at most {most}"
    RELATIVE = "{folder}: give an absolute path"
    NUL = "has a NUL character or half of a character: remove it"
    NO_FOLDER = "{folder} is no folder on this machine: nothing is listed from there"
    MAY = "{peer} may list and get recordings, of the topics that it may read"
    FOLDERS = "recordings are listed from {folders}, and from the bridge's own folder"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    place, folders = f"{RECORDINGS_KEY.name}.folders", RECORDINGS_KEY.of(session).folders
    if len(folders) > _MOST_FOLDERS:
        yield place, CourierRulesText.TOO_MANY(count=len(folders), most=_MOST_FOLDERS)
    if (size := RECORDINGS_KEY.of(session).fetched) not in FETCHED_SIZE:
        yield f"{RECORDINGS_KEY.name}.fetched", RecordText.OUT_OF_RANGE(value=size, range=FETCHED_SIZE)
    for at, folder in enumerate(folders):
        if "\0" in folder or any(0xD800 <= ord(character) <= 0xDFFF for character in folder):
            yield f"{place}[{at}]", CourierRulesText.NUL()
        elif not folder.startswith("/"):
            yield f"{place}[{at}]", CourierRulesText.RELATIVE(folder=one_line(folder))


def advice(session: Session, file: Path | None) -> Iterator[tuple[str, str]]:
    """Yield advice, as `Feature.advice`."""
    for at, folder in enumerate(RECORDINGS_KEY.of(session).folders):
        if file is not None and not Path(folder).is_dir():
            yield f"{RECORDINGS_KEY.name}.folders[{at}]", CourierRulesText.NO_FOLDER(folder=one_line(folder))


def effects(session: Session) -> Iterator[str]:
    """Yield the folders, and the peers that get recordings."""
    if folders := RECORDINGS_KEY.of(session).folders:
        yield CourierRulesText.FOLDERS(folders=", ".join(map(one_line, folders)))
    clients = session.accepted_clients if session.role == "server" else ()
    holders = [(client.name, MAY_FETCH.of(client)) for client in clients] or [("the server", MAY_FETCH.of(session))]
    yield from (CourierRulesText.MAY(peer=peer) for peer, may in holders if may)
