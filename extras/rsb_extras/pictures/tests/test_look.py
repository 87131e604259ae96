"""The command ``look``: one picture or many, on a terminal, in files and for programs."""

from __future__ import annotations

import re
from argparse import Namespace
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast
from xml.etree import ElementTree

import pytest
from rich.style import Style
from tests.support import surroundings
from tests.support.waiting import eventually
from tests.support.wording import has_text, says

from rsb_bridge.api import EngineError
from rsb_console.notation import formats
from rsb_console.terminal.terminal_facts import TerminalFacts
from rsb_extras.pictures import look_command
from rsb_extras.pictures.look_command import LookText
from rsb_extras.pictures.picture import Cells, Curve, Picture, Pixels, Series, Viewed, Wish
from rsb_extras.pictures.tests import picture_places
from rsb_extras.pictures.tests.looking_engine import LookingEngine

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.control import Machine

    from rsb_bridge.control.remote_engine import RemoteEngine

ARGUMENTS = Namespace(
    facts=TerminalFacts(),
    graphics="blocks",
    detail=None,
    topics=["/t"], link="", width=40, height=5, rate=2.0, how="", field=[], zoom=1.0, tilt=0.0, frame="",
    colour="height", seconds=30.0, match="", ascii=True, json=False, timeout=None, output=None,
)  # fmt: skip
PICTURE = Viewed(Picture(Cells(("picture",))), "robot1", 0.5)
STEP = 4.0


class Engine:
    """Answers each question with the next of its answers, and further ones never."""

    bridge = Namespace(role="server")

    def __init__(self, *answers: Viewed | Exception) -> None:
        self._answers = list(answers)

    def do(self, _: Any) -> Future[Viewed]:
        future: Future[Viewed] = Future()
        if self._answers:
            answer = self._answers.pop(0)
            if isinstance(answer, Exception):
                future.set_exception(answer)
            else:
                future.set_result(answer)
        return future


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """Return what the command draws, one time after another, `STEP` seconds apart."""

    def draw(*answers: Viewed | Exception, times: int) -> list[str]:
        now, waits = [100.0], [0]

        def wait(*_: Any) -> None:
            waits[0] += 1
            now[0] += STEP
            if waits[0] > times:
                raise KeyboardInterrupt

        picture_places.LOOK_WAIT.set(monkeypatch, wait)
        picture_places.LOOK_TIME.set(monkeypatch, SimpleNamespace(monotonic=lambda: now[0], sleep=lambda _: None))
        with pytest.raises(KeyboardInterrupt):
            look_command.many(cast("RemoteEngine", Engine(*answers)), "viewer", ARGUMENTS)
        return capsys.readouterr().out.split("\x1b[H")[1:]

    return draw


def test_the_age_of_a_picture_goes_on(drawn: Callable[..., list[str]]) -> None:
    first, second, third = drawn(PICTURE, times=3)
    for screen, age in ((first, 0.5), (second, 0.5 + STEP), (third, 0.5 + 2 * STEP)):
        assert LookText.AGE(age=formats.age(age)) in screen
        assert "picture" in screen


def test_the_last_picture_stays_beside_a_problem(drawn: Callable[..., list[str]]) -> None:
    _, second = drawn(PICTURE, EngineError("gone"), times=2)
    assert "gone" in second
    assert "picture" in second


def test_a_damaged_picture_does_not_end_the_command(drawn: Callable[..., list[str]]) -> None:
    damaged = Viewed(Picture(Pixels(2, 2, b"RIFFxxxxWEBP", "webp")))
    _, second = drawn(damaged, PICTURE, times=2)
    assert "picture" in second


def test_a_picture_for_a_larger_terminal_is_cut(drawn: Callable[..., list[str]]) -> None:
    (screen,) = drawn(
        Viewed(Picture(Cells(("x" * 400,) * 150, bytes(range(2)) * 30_000, ("", "ok"))), "robot1"), times=1
    )
    lines = [re.sub("\x1b[^a-zA-Z]*[a-zA-Z]", "", line) for line in screen.split("\r\n")]
    assert lines[:-1] == ["x" * ARGUMENTS.width] * ARGUMENTS.height


def test_before_the_first_message(drawn: Callable[..., list[str]]) -> None:
    (first,) = drawn(times=1)
    assert has_text(first, LookText.NO_MESSAGE)


def test_why_there_is_no_message(drawn: Callable[..., list[str]]) -> None:
    waiting = Viewed(Picture(waiting="2 publishers, best effort"), "robot1")
    first, second, third = drawn(waiting, PICTURE, waiting, times=3)
    assert "2 publishers" in first
    assert "2 publishers" not in second
    assert "picture" in third


IMAGE = Pixels(2, 2, b"\xff\0\0\0\xff\0\0\0\xff\xff\xff\xff")
CHARACTERS = Cells(("a row", "──▶"), bytes((1,) * 8), ("", "robot"))
CURVES = Series(0.0, 0.5, (Curve("x", (1.0, 2.0), (1.0, 3.0), 3.0, 2.0),))


@pytest.fixture
def engine(machine: Machine) -> LookingEngine:
    return machine.have(LookingEngine())


@pytest.fixture
def ran(ran: Any) -> Any:
    return partial(ran, "look")


def viewed(content: Cells | Pixels | Series | None = CHARACTERS, problem: str = "", note: str = "a note") -> Viewed:
    picture = Picture(content, 1, 2, 3, 4, "sensor_msgs/msg/LaserScan", (note,), problem)
    return Viewed(picture, "robot1", 1.5, 1234)


def looks(engine: LookingEngine) -> list[tuple[Any, ...]]:
    return [command[1:] for command in engine.commands if command[0] == "look"]


@pytest.mark.parametrize("options", [["--once"], []], ids=["once", "no terminal"])
def test_it_prints_picture_and_how_old_it_is(ran: Any, engine: LookingEngine, options: list[str]) -> None:
    engine.viewed = [viewed()]
    done = ran("/scan", *options)
    assert done.code == 0
    assert done.err == ""
    first, second, status = done.out.splitlines()
    assert (first, second) == CHARACTERS.rows
    assert says(status, LookText.AGE)
    assert "a note" in status
    assert "the server" in status  # though the link has the client's name


def test_it_waits_for_a_picture(ran: Any, engine: LookingEngine) -> None:
    engine.viewed = [Viewed(Picture()), Viewed(Picture(messages=1)), viewed()]
    assert ran("/scan", "--once").out.startswith("a row\n")
    assert len(looks(engine)) == 3


def test_a_picture_for_programs(ran: Any, engine: LookingEngine) -> None:
    engine.viewed = [viewed(problem="a layer is missing")]
    done = ran("/scan", "--once", "--json")
    assert done.code == 0
    found = done.json
    assert 1.5 <= found.pop("age") < 60
    assert found == {
        "ok": True,
        "side": "the server",
        "type": "sensor_msgs/msg/LaserScan",
        "messages": 3,
        "size": 4,
        "encoded": 1234,
        "notes": ["a note"],
        "problem": "a layer is missing",
        "rows": [*CHARACTERS.rows],
    }


@pytest.mark.parametrize(("content", "lines"), [(IMAGE, 12), (CURVES, 12)])
def test_rows_for_programs(ran: Any, engine: LookingEngine, content: Pixels | Series, lines: int) -> None:
    engine.viewed = [viewed(content)]
    rows = ran("/scan", "--once", "--json", "--width", "40", "--height", "12").json["rows"]
    assert len(rows) == lines
    assert "\x1b" not in "".join(rows)


def test_the_options_are_the_wish(ran: Any, engine: LookingEngine) -> None:
    engine.viewed = [viewed()]
    options = (
        "--once --link robot1 --as plot --field a.b --field c[2] --seconds 60 --rate 0.5 --zoom 2 --tilt 30 "
        "--colour intensity --frame odom --match arm --width 50 --height 20"
    )
    assert ran("/map", "/scan", *options.split()).code == 0
    topics, wish, link = looks(engine)[0]
    assert (topics, link) == (("/map", "/scan"), "robot1")
    assert wish == Wish(
        width=50, height=20, rate=0.5, how="plot", fields=("a.b", "c[2]"), zoom=2.0, tilt=30.0, frame="odom",
        colour="intensity", seconds=60.0, match="arm", webp=wish.webp,
    )  # fmt: skip


def test_without_options_the_picture_fits_the_terminal(
    ran: Any, engine: LookingEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    monkeypatch.setenv("LINES", "20")
    engine.viewed = [viewed()]
    assert ran("/scan", "--once").code == 0
    ((_, wish, _),) = looks(engine)
    assert wish == Wish(width=70, height=19, webp=wish.webp)


@pytest.mark.parametrize(("columns", "lines"), [("1", "1"), ("5000", "5000")])
def test_any_terminal_has_a_picture(
    ran: Any, engine: LookingEngine, monkeypatch: pytest.MonkeyPatch, columns: str, lines: str
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("LINES", lines)
    engine.viewed = [viewed()]
    assert ran("/scan", "--once").code == 0


@pytest.mark.parametrize(
    ("answers", "row"),
    [
        ([viewed(), Viewed(Picture()), viewed(Cells(("both",)))], "both"),
        ([viewed(None, problem="no transform yet"), viewed(None, problem="no transform yet"), viewed()], "a row"),
        ([viewed(), viewed(None, problem="no transform any more")], "a row"),
    ],
)
def test_of_several_topics_it_prints_the_last_picture(
    ran: Any, engine: LookingEngine, monkeypatch: pytest.MonkeyPatch, answers: list[Viewed], row: str
) -> None:
    engine.viewed = [*answers]
    # The time is over once the last answer was given out.
    picture_places.LOOK_SETTLES_IN.set(monkeypatch, 60.0)
    picture_places.LOOK_TIME.set(monkeypatch, SimpleNamespace(monotonic=lambda: 0.0 if engine.viewed else 1e6))
    assert ran("/map", "/scan", "--once").out.startswith(f"{row}\n")


@pytest.mark.parametrize("answer", [viewed(), viewed(None, problem="numpy is missing there")])
def test_the_command_ends_its_view(ran: Any, engine: LookingEngine, answer: Viewed) -> None:
    engine.viewed = [answer]
    ran("/scan", "--once")
    eventually(lambda: engine.commands[-1] == ("end_look",))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def make(**variables: str) -> None:
        for name in ("NO_COLOR", "COLORTERM"):
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        surroundings.print_to_terminal(monkeypatch)
        Style.parse.cache_clear()  # a parsed style keeps the codes of the first terminal

    return make


@pytest.mark.parametrize(
    ("variables", "sequence"),
    [
        ({"TERM": "xterm", "COLORTERM": "truecolor"}, "\x1b[38;2;252;0;0;48;2;0;0;252m▀"),
        ({"TERM": "xterm-256color"}, "\x1b[38;5;196;48;5;21m▀"),
        ({"TERM": "xterm"}, "\x1b[91;44m▀"),
        ({"TERM": "screen"}, "\x1b[91;44m▀"),
    ],
)
def test_a_terminal_gets_the_colours_that_it_has(
    ran: Any, engine: LookingEngine, terminal: Callable[..., None], variables: dict[str, str], sequence: str
) -> None:
    terminal(**variables)
    engine.viewed = [viewed(Pixels(2, 4, b"\xff\0\0" * 4 + b"\0\0\xff" * 4))]
    assert sequence in ran("/camera", "--once").out


@pytest.mark.parametrize(
    ("options", "variables"),
    [(["--ascii"], {}), ([], {"NO_COLOR": "1"}), ([], {"NO_COLOR": ""}), ([], {"TERM": "dumb"})],
)
def test_without_colours_an_image_is_ascii(
    ran: Any, engine: LookingEngine, terminal: Callable[..., None], options: list[str], variables: dict[str, str]
) -> None:
    terminal(**({"TERM": "xterm", "COLORTERM": "truecolor"} | variables))
    engine.viewed = [viewed(IMAGE)]
    row = ran("/camera", "--once", *options).out.splitlines()[0]
    assert row.isascii()
    assert len(row) == 46  # as wide as high, in 23 rows
    assert "\x1b" not in row


def test_styles_have_colours_on_a_terminal(ran: Any, engine: LookingEngine, terminal: Callable[..., None]) -> None:
    terminal(TERM="xterm", COLORTERM="truecolor")
    engine.viewed = [viewed(Cells(("abc",), bytes((0, 1, 2)), ("", "error", "#010203")))]
    row = ran("/scan", "--once").out.splitlines()[0]
    assert row == "a\x1b[1;31mb\x1b[0m\x1b[38;2;1;2;3mc\x1b[0m"


@pytest.mark.parametrize(
    ("content", "suffix"), [(IMAGE, ".png"), (CHARACTERS, ".svg"), (CHARACTERS, ".txt"), (CURVES, ".csv")]
)
@pytest.mark.parametrize("options", [[], ["--json"]], ids=["text", "json"])
def test_a_picture_is_written_to_a_file(
    ran: Any, engine: LookingEngine, tmp_path: Path, content: Any, suffix: str, options: list[str]
) -> None:
    engine.viewed = [viewed(content)]
    file = tmp_path / f"picture{suffix}"
    done = ran("/scan", "--output", str(file), *options)
    assert done.code == 0
    if options:
        assert done.json == {"ok": True, "file": str(file)}
    else:
        assert says(done.out, LookText.WRITTEN, file=file)
    if suffix == ".png":
        image = pytest.importorskip("PIL.Image", reason="needs Pillow").open(file)
        assert (image.size, image.convert("RGB").tobytes()) == ((2, 2), IMAGE.data)
    elif suffix == ".svg":
        root = ElementTree.parse(file).getroot()
        assert "".join(root.itertext()).strip() == "".join(CHARACTERS.rows)
    elif suffix == ".txt":
        assert tuple(file.read_text(encoding="utf-8").splitlines()) == CHARACTERS.rows
    else:
        assert file.read_text(encoding="utf-8").splitlines()[1:] == ["0.000000,1.0,1.0", "0.500000,2.0,3.0"]


@pytest.mark.parametrize(
    ("options", "size"),
    [
        ([], (400, 150, 16)),
        (["--detail", "8"], (80, 23, 8)),
        (["--width", "50", "--detail", "2"], (50, 23, 2)),
        (["--width", "50"], (50, 23, 6)),
    ],
)
def test_a_file_has_the_image_s_own_resolution(
    ran: Any, engine: LookingEngine, tmp_path: Path, options: list[str], size: tuple[int, int, int]
) -> None:
    engine.viewed = [viewed(IMAGE)]
    assert ran("/camera", "--output", str(tmp_path / "a.png"), *options).code == 0
    ((_, wish, _),) = looks(engine)
    assert (wish.width, wish.height, wish.across) == size


@pytest.mark.parametrize(("graphics", "sequence"), [("kitty", "\x1b_Ga=T"), ("sixel", "\x1bP")])
@pytest.mark.parametrize(("options", "detail"), [([], 10), (["--detail", "8"], 8)])
def test_one_picture_in_pixels(
    ran: Any, engine: LookingEngine, graphics: str, sequence: str, options: list[str], detail: int
) -> None:
    """Larger than any that blocks are asked for, and the status below it."""
    engine.viewed = [viewed(Pixels(640, 480, bytes(3 * 640 * 480)))]
    done = ran("/camera", "--once", "--graphics", graphics, *options)
    assert (done.code, done.err) == (0, "")
    ((_, wish, _),) = looks(engine)
    assert (wish.across, wish.down) == (detail, 2 * detail)
    before, _, after = done.out.partition(sequence)
    rows = before.count("\n")
    assert 1 <= rows <= wish.height
    assert before.endswith(f"\x1b[{rows}A\x1b7\x1b8")
    below, _, status = after.rpartition(f"\x1b8\x1b[{rows}B")
    assert below
    assert says(status, LookText.AGE)


def test_one_picture_asks_the_terminal(
    ran: Any, engine: LookingEngine, terminal: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal(TERM="xterm", COLORTERM="truecolor")
    surroundings.set_stdin(monkeypatch, "", is_terminal=True)
    picture_places.ASK_TERMINAL.set(monkeypatch, lambda facts, *_: replace(facts, pixels="kitty"))
    engine.viewed = [viewed(IMAGE), viewed(IMAGE), viewed()]
    assert "\x1b_G" in ran("/camera", "--once").out
    assert "\x1b_G" not in ran("/camera", "--once", "--json").out
    assert "a row" in ran("/scan", "--once").out


@pytest.mark.parametrize("name", ["picture.jpg", "picture", "picture.PNG", ".png"])
def test_a_file_of_another_kind_is_wrong_usage(ran: Any, engine: LookingEngine, tmp_path: Path, name: str) -> None:
    done = ran("/scan", "--output", str(tmp_path / name))
    assert done.code == 2
    assert says(done.err, LookText.UNKNOWN_FORMAT, file=tmp_path / name)
    assert not looks(engine)
    assert not [*tmp_path.glob("**/picture*")]


@pytest.mark.parametrize(
    ("content", "name"), [(IMAGE, "a.csv"), (CURVES, "a.png"), (CHARACTERS, "a.csv"), (CHARACTERS, "missing/a.svg")]
)
def test_a_picture_that_cannot_be_written(
    ran: Any, engine: LookingEngine, tmp_path: Path, content: Any, name: str
) -> None:
    engine.viewed = [viewed(content)]
    done = ran("/scan", "--output", str(tmp_path / name))
    assert done.code == 1
    assert says(done.err, LookText.NOT_WRITTEN, file=tmp_path / name)
    assert not [*tmp_path.glob("**/a.*")]


def test_a_reason_instead_of_a_picture(ran: Any, engine: LookingEngine) -> None:
    engine.viewed = [viewed(None, problem="numpy is missing there"), viewed(None, problem="numpy is missing there")]
    done = ran("/scan", "--once")
    assert done.code == 1
    assert "numpy is missing there" in done.err
    done = ran("/scan", "--once", "--json")
    assert done.code == 1
    assert done.json == {"ok": False, "error": "numpy is missing there"}


def test_where_nothing_comes_it_gives_up(ran: Any, engine: LookingEngine) -> None:
    done = ran("/scan", "--once", "--timeout", "0.3")
    assert done.code == 1
    assert says(done.err, LookText.NOTHING_CAME, topic="/scan", seconds=0.3)
    eventually(engine.viewing.cancelled)


def test_what_is_known_where_nothing_comes(ran: Any, engine: LookingEngine) -> None:
    engine.viewed = [Viewed(Picture(waiting="2 publishers, best effort"), "robot1")]
    done = ran("/scan", "--once", "--timeout", "0.3")
    assert done.code == 1
    assert "2 publishers, best effort" in done.err


def test_a_damaged_image_is_refused(ran: Any, engine: LookingEngine, tmp_path: Path) -> None:
    damaged = Pixels(2, 2, b"RIFFxxxxWEBP", "webp")
    engine.viewed = [viewed(damaged), viewed(damaged)]
    assert ran("/scan", "--once").code == 1
    assert ran("/scan", "--output", str(tmp_path / "a.png")).code == 1


def test_nothing_in_picture_reaches_terminal_as_command(
    ran: Any, engine: LookingEngine, terminal: Callable[..., None]
) -> None:
    terminal(TERM="xterm", COLORTERM="truecolor")
    engine.viewed = [viewed(Cells(("\x1b[2J\u202e\x9b31m",)), note='"[red]')]
    printed = ran("/scan", "--once").out
    assert all(character.isprintable() or character == "\n" for character in printed)
    assert '\\"[red]' in printed
