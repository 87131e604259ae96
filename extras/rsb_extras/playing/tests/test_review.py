"""A recording is looked at as topics are: what the chosen topic shows at the chosen time."""

from __future__ import annotations

import asyncio
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from tests.console.driving import WIDE, notified, on_main, shown, text
from tests.support.wording import says

from rsb_extras.pictures.picture import Pixels, Series, Wish
from rsb_extras.pictures.renderer import Renderer
from rsb_extras.playing.recorded_pictures import SECOND, RecordedPictures
from rsb_extras.playing.recordings_here import recordings_here
from rsb_extras.playing.review_app import ReviewApp
from rsb_extras.playing.review_command import NoReview
from rsb_extras.playing.review_screen import ReviewScreen, ReviewText
from rsb_extras.playing.tests.recorded import BEGIN, ODD, ODD_TYPE, Recorded, odd, string
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import UnreadableRecording

IMAGE = """\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
""" + "".join(
    f"{'=' * 80}\nMSG: {name}\n{text}\n"
    for name, text in (
        ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
        ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
    )
)


def image(grey: int) -> bytes:
    """Return an image of 8 × 8 pixels of one brightness."""
    encoding = struct.pack("<I", 6) + b"mono8\0"
    head = struct.pack("<iII", 1, 0, 1) + b"\0" + b"\0\0\0" + struct.pack("<II", 8, 8) + encoding
    head += b"\0" + bytes(-(len(head) + 1) % 4) + struct.pack("<II", 8, 64)
    return b"\0\1\0\0" + head + bytes([grey]) * 64


def float64(value: float) -> bytes:
    return b"\0\1\0\0" + struct.pack("<d", value)


@pytest.fixture
def path(recorded: Recorded) -> Path:
    recorded.topic("/text")
    recorded.topic("/value", "std_msgs/msg/Float64", "float64 data")
    recorded.topic("/camera", "sensor_msgs/msg/Image", IMAGE)
    recorded.topic("/odd", ODD_TYPE, ODD)
    for number in range(20):
        recorded.add("/text", number * 1.0, string(f"number {number}"))
        recorded.add("/value", number * 1.0 + 0.1, float64(number))
        recorded.add("/odd", number * 1.0 + 0.2, odd(number))
    for number, grey in enumerate((0, 255)):
        recorded.add("/camera", number * 10.0 + 0.3, image(grey))
    return recorded.done()


def at(seconds: float) -> int:
    return BEGIN + round(seconds * SECOND)


# --- pictures


async def _seen(path: Path, *places: tuple[str, float]) -> list[Any]:
    renderer = Renderer()
    try:
        pictures = RecordedPictures(OpenRecording(path), renderer)
        return [await pictures.at(topic, at(seconds), Wish(across=2, down=4)) for topic, seconds in places]
    finally:
        renderer.close()


def test_picture_is_that_of_the_time(path: Path) -> None:
    """Forth, back, and far behind the last message before."""
    places = (("/camera", 1.0), ("/camera", 10.5), ("/camera", 2.0), ("/camera", 19.0), ("/camera", 0.1))
    first, second, back, late, before = asyncio.run(_seen(path, *places))
    for moment in (first, second, back, late):
        assert isinstance(moment.picture.content, Pixels), moment.picture
    assert first.picture.content == back.picture.content != second.picture.content == late.picture.content
    assert (before.message, before.picture.content) == (None, None)


def test_plot_has_the_messages_until_the_time(path: Path) -> None:
    places = (("/value", 5.5), ("/value", 6.5), ("/value", 3.5))
    moments = asyncio.run(_seen(path, *places))
    assert all(isinstance(each.picture.content, Series) for each in moments)
    assert [each.picture.messages for each in moments] == [6, 7, 4]


def test_type_that_is_installed_nowhere_is_read(path: Path) -> None:
    (moment,) = asyncio.run(_seen(path, ("/odd", 3.5)))
    assert (moment.picture.problem, moment.picture.content is None) == ("", False)
    assert bytes(moment.message.content) == odd(3)


# --- the screen


async def _show(path: Path, config: Path, use: Any, topic: str = "", seconds: float | None = None) -> None:
    begin = None if seconds is None else at(seconds)
    app = ReviewApp(OpenRecording(path), topic, begin, ascii_only=True, config=config)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.pause()
        screen = app.screen
        assert isinstance(screen, ReviewScreen)
        await use(pilot)


def test_screen_lists_topics_and_shows_one(path: Path, tmp_path: Path) -> None:
    async def use(pilot: Any) -> None:
        await shown(pilot, "number 7")
        for topic in ("/text", "/value", "/camera", "/odd"):
            assert topic in text(pilot.app)
        assert "7.500 / 19.2 s" in text(pilot.app)
        await pilot.press("up")
        await shown(pilot, "rest:")  # of /odd

    asyncio.run(_show(path, tmp_path, use, "/text", 7.5))


def test_keys_step_and_seek(path: Path, tmp_path: Path) -> None:
    async def use(pilot: Any) -> None:
        await shown(pilot, "number 7")
        await pilot.press("full_stop")
        await shown(pilot, "number 8")
        await pilot.press("comma")
        await shown(pilot, "number 7")
        await pilot.press("right")
        await shown(pilot, "number 12")
        await pilot.press("left", "left", "left", "left")
        await shown(pilot, "number 0")

    asyncio.run(_show(path, tmp_path, use, "/text", 7.5))


def test_it_plays_and_stops_at_the_end(path: Path, tmp_path: Path) -> None:
    async def use(pilot: Any) -> None:
        await pilot.press("greater_than_sign", "space")
        await shown(pilot, "playing 2x")
        await shown(pilot, "number 19")
        await shown(pilot, ReviewText.STANDS())
        assert pilot.app.screen.position == at(19.2)

    asyncio.run(_show(path, tmp_path, use, "/text", 17.5))


def test_time_before_the_first_message_says_so(path: Path, tmp_path: Path) -> None:
    async def use(pilot: Any) -> None:
        await shown(pilot, "no message of /camera")
        await pilot.press("full_stop")
        await shown(pilot, "sensor_msgs/msg/Image")

    asyncio.run(_show(path, tmp_path, use, "/camera", 0.0))


@on_main(WIDE)
async def test_look_lists_recordings_of_this_machine(
    app: Any, pilot: Any, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`V` opens one; esc leads back."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    folder = tmp_path / "state" / "recordings"
    folder.mkdir(parents=True)
    shutil.copy(path, folder / "stretch.mcap")
    (folder / ".stretch.fetch").mkdir()
    await pilot.press("V", *"stretch")
    await shown(pilot, "recording stretch.mcap")
    assert ".fetch" not in text(app)
    await pilot.press("enter")
    await shown(pilot, "/ 19.2 s")
    await shown(pilot, "/camera  2  sensor_msgs/msg/Image")
    await pilot.press("escape")
    await shown(pilot, "/robot2/scan")


def test_link_that_leads_nowhere_hides_no_recording(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    for number in range(20):
        (folder / f"gone{number}.mcap").symlink_to(tmp_path / "none.mcap")
    (folder / "stretch.mcap").touch()
    assert recordings_here({"STATE_DIRECTORY": str(tmp_path)})[:1] == [folder / "stretch.mcap"]


def test_what_was_fetched_is_listed_and_not_its_folder(tmp_path: Path) -> None:
    fetched = tmp_path / "recordings" / "fetched"
    fetched.mkdir(parents=True)
    for name in ("robot1-noon.mcap", "robot2-noon.mcap"):
        (fetched / name).touch()
    found = recordings_here({"STATE_DIRECTORY": str(tmp_path)})
    assert {*found} == {fetched / "robot1-noon.mcap", fetched / "robot2-noon.mcap"}


@on_main(WIDE)
async def test_recordings_of_one_name_are_told_apart(
    app: Any, pilot: Any, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    monkeypatch.setattr("rsb_extras.playing.recordings_here.searched_folders", lambda _: folders)
    for folder in folders:
        (folder / "recordings").mkdir(parents=True)
        shutil.copy(path, folder / "recordings" / "stretch.mcap")
    await pilot.press("V", *"stretch")
    await shown(pilot, "recording stretch.mcap")
    assert text(app).count("recording stretch.mcap") == 2


@on_main(WIDE)
async def test_recording_that_cannot_be_read_is_told(
    app: Any, pilot: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "odd.mcap").write_text("text" * 20)
    await pilot.press("V", *"odd", "full_stop", *"mcap", "enter")
    await notified(pilot, UnreadableRecording.NO_RECORDING)


# --- the command


def test_it_leaves_the_terminal_as_it_was(path: Path, at_terminal: Any) -> None:
    app = at_terminal("review", str(path), "/text", "--at", "7.5", "--ascii")
    app.wait_for("number 7")
    app.press("q")
    assert app.process.wait(60) == 0
    assert app.text.rindex("\x1b[?1049l") > app.text.rindex("\x1b[?1049h")


def test_without_a_terminal_it_says_what_to_do(path: Path, ran: Any) -> None:
    done = ran("review", str(path))
    assert (done.code, says(done.err, NoReview.NO_TERMINAL)) == (2, True)


def test_topic_that_is_not_in_it_is_refused(path: Path, at_terminal: Any) -> None:
    app = at_terminal("review", str(path), "/scam")
    assert app.exit_code() == 2
    assert says(app.text, NoReview.NO_TOPIC, topic="/scam")
