"""The arguments that lists and fetches add to the command ``record``, and the keys of the screen of recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import KeyChapter, subcommand

if TYPE_CHECKING:
    import argparse

    from rsb_console.feature_console import Complete

ACTIONS = ("list", "get", "missing", "cancel")
_MORE = """\
With `list`, recordings of both sides are listed, or of one link. With `get`, one of
the other side is brought here, whole or by topics and times, over cuts and restarts
of both bridges; Ctrl-C only ends the display. The other side's session permits
it: may: {recordings: true}. With --complete, only what did not come live is fetched,
and one file has both, each message once, on this side's clock; with `missing`, such a
file says what neither side has, and why.

for example:
  rsb-console record
  rsb-console record list robot1
  rsb-console record get robot1 robot1-20260730-101500-fault /scan /tf --from -30
  rsb-console record get robot1 robot1-20260730-101500-fault --complete /scan /tf
  rsb-console record missing robot1-robot1-20260730-101500-fault-completed.mcap
  rsb-console record cancel robot1-robot1-20260730-101500-fault
"""
CHAPTER = KeyChapter(
    "Recordings", "RecordingsScreen",
    (("enter g", "get the recording from the other side"),
     ("c", "complete what came live here by it, after a form"),
     ("m", "show what neither side has of it, once it is completed, or of such a file here"),
     ("x", "give up its fetch, after a question"), ("esc", "close")),
)  # fmt: skip


def add_to_record(parser: argparse.ArgumentParser, complete: Complete) -> None:
    parser.epilog = f"{_MORE}\n{parser.epilog or ''}"
    parser.set_defaults(command=subcommand("rsb_extras.courier.courier_command:record"))
    actions = "list recordings, get one, tell what one lacks, or give a fetch up; without it, write the last seconds"
    parser.add_argument("action", nargs="?", choices=ACTIONS, help=actions)
    words = "list: LINK; get: LINK RECORDING TOPIC...; missing: RECORDING; cancel: the fetch's name"
    complete(parser.add_argument("words", nargs="*", metavar="WORD", help=words), "links")
    when = "a time as list prints it, or seconds from the begin, or with - from the end"
    parser.add_argument("--from", dest="begin", metavar="TIME", help=f"get: from then on; {when}")
    parser.add_argument("--to", dest="end", metavar="TIME", help="get: up to then; the same")
    whole = "get: complete what came live on this side, which record: {disk: ...} keeps"
    parser.add_argument("--complete", action="store_true", help=whole)
    part = "get --complete: this recording of this side, as list prints it; default: all of this bridge"
    parser.add_argument("--with", dest="live", metavar="RECORDING", help=part)
    parser.add_argument("--no-wait", action="store_true", help="get: end at once; the bridge goes on")
