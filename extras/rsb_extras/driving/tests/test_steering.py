"""What keys mean and for how long, and which of them come too late to mean anything."""

import random

import pytest
from textual.binding import Binding

from rsb_console.actions.all_actions import BY_ID
from rsb_extras.driving.drive_screen import DriveScreen
from rsb_extras.driving.steering import STOPS, WAYS, Steering

LABELS = {
    "up": "↑", "down": "↓", "left": "←", "right": "→", "comma": ",", "full_stop": ".",
    "plus": "+", "equals_sign": "+", "minus": "-", "escape": "esc",
}  # fmt: skip


def test_all_keys_are_in_the_help() -> None:
    (chapter,) = BY_ID["drive"].chapters
    listed = "".join(keys for keys, _ in chapter.keys)
    bound = [binding.key for binding in DriveScreen.BINDINGS if isinstance(binding, Binding)]
    keys = {key for each in bound for key in each.split(",")} | {*WAYS, *STOPS}
    assert all(LABELS.get(key, key) in listed for key in keys)
    assert chapter.screen == DriveScreen.__name__


LASTS = 0.6
SPEED, TURN = 0.2, 0.5


def steered(*keys: str, at: float = 10.0) -> Steering:
    """Return the steering of keys that are pressed at once."""
    steering = Steering()
    for key in keys:
        steering.press(key, at)
    return steering


@pytest.mark.parametrize(
    ("keys", "forward", "turn"),
    [
        (["up"], 1, 0), (["down"], -1, 0), (["left"], 0, 1), (["right"], 0, -1),
        (["i"], 1, 0), (["comma"], -1, 0), (["j"], 0, 1), (["l"], 0, -1),
        (["u"], 1, 1), (["o"], 1, -1), (["m"], -1, -1), (["full_stop"], -1, 1),
        (["up", "left"], 1, 1), (["right", "down"], -1, -1), (["up", "down"], -1, 0), (["left", "right"], 0, -1),
        (["u", "right"], 1, -1), (["up", "o"], 1, -1),
        (["up", "k"], 0, 0), (["u", "space"], 0, 0), (["k"], 0, 0), (["space", "up"], 1, 0), ([], 0, 0),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_each_key_has_a_velocity(keys: list[str], forward: int, turn: int) -> None:
    assert steered(*keys).at(10.0) == (forward * SPEED, turn * TURN)


def test_a_key_counts_for_a_while() -> None:
    steering = steered("u")
    assert steering.at(10.0 + LASTS - 0.01) == (SPEED, TURN)
    assert steering.at(10.0 + LASTS + 0.01) == (0.0, 0.0)


def test_each_direction_has_its_own_time() -> None:
    steering = steered("up")
    steering.press("left", 10.4)
    assert steering.at(10.5) == (SPEED, TURN)
    assert steering.at(10.7) == (0.0, TURN)
    steering.press("up", 10.8)
    assert steering.at(10.9) == (SPEED, TURN)
    assert steering.at(11.1) == (SPEED, 0.0)


def test_a_key_that_repeats_goes_on() -> None:
    steering = Steering()
    for number in range(50):
        steering.press("up", 10.0 + number / 30)
        assert steering.at(10.0 + number / 30) == (SPEED, 0.0)


def test_the_speed_has_limits() -> None:
    steering = steered("u")
    steering.change_speed(1.25)
    assert steering.at(10.0) == pytest.approx((0.25, 0.625))
    ratio = steering.turn / steering.speed
    for factor, limit in ((1.25, 2.0), (1 / 1.25, 0.02)):
        for _ in range(50):
            steering.change_speed(factor)
        assert steering.speed == limit
        assert steering.turn / steering.speed == pytest.approx(ratio)


def test_keys_that_come_all_at_once_are_ignored() -> None:
    """A terminal or a line held them up: what they ask for is over."""
    steering = Steering()
    for number in range(30):
        steering.press("up", 10.0 + number / 1000)
    assert steering.at(10.03) == (0.0, 0.0)
    assert steering.came_late(10.03)
    steering.press("up", 10.2)
    assert steering.at(10.2) == (0.0, 0.0)
    assert not steering.came_late(10.4)
    steering.press("up", 10.4)
    assert steering.at(10.4) == (SPEED, 0.0)


def test_two_keys_that_repeat_are_no_burst() -> None:
    steering = Steering()
    for number in range(60):
        steering.press("up" if number % 2 else "left", 10.0 + number / 80)
        assert not steering.came_late(10.0 + number / 80)


def test_keys_that_waited_for_stalled_console_drive_nothing() -> None:
    steering = Steering()
    assert steering.at(0.0) == (0.0, 0.0)
    steering.press("up", 0.1)
    assert steering.at(0.2)[0] > 0
    steering.press("up", 5.0)
    assert steering.came_late(5.0)
    assert steering.at(5.1) == (0.0, 0.0)
    for tenths in range(52, 60):
        assert steering.at(tenths / 10) == (0.0, 0.0)
    steering.press("up", 6.0)
    assert steering.at(6.1)[0] > 0


# -- behind a multiplexer


def moves(*presses: tuple[str, float], at: float) -> bool:
    steering = Steering(lambda: True)
    for key, now in presses:
        steering.press(key, now)
    return steering.at(at) != (0.0, 0.0)


def test_a_motion_begins_with_a_held_keys_third() -> None:
    assert not moves(("up", 10.0), at=10.0)
    assert not moves(("up", 10.0), ("up", 10.5), at=10.5)
    assert moves(("up", 10.0), ("up", 10.5), ("up", 10.53), at=10.53)
    assert moves(("up", 10.0), ("up", 10.2), ("up", 10.25), ("left", 10.4), at=10.8)
    assert not moves(("up", 10.0), ("up", 10.5), ("down", 10.53), at=10.53)
    assert not moves(("up", 10.0), ("up", 10.9), ("up", 10.93), at=10.93)
    assert not moves(("up", 10.0), ("up", 10.03), ("up", 10.06), at=10.06)
    assert not moves(("up", 10.0), ("up", 10.3), ("up", 10.6), ("up", 10.9), at=10.9)


def test_a_held_key_goes_on() -> None:
    steering = Steering(lambda: True)
    steering.press("up", 10.0)
    for number in range(100):
        now = 10.5 + number / 30
        steering.press("up", now)
        assert steering.at(now) == ((0.2, 0.0) if number else (0.0, 0.0))


def test_a_held_key_begins_over_a_shaky_line() -> None:
    gaps = [0.5, 0.005, 0.055, 0.03, 0.03, 0.03]
    presses = [("up", 10.0 + sum(gaps[:count])) for count in range(len(gaps) + 1)]
    assert not moves(*presses[:-1], at=presses[-2][1])
    assert moves(*presses, at=presses[-1][1])


@pytest.mark.parametrize("count", [1, 3, 6, 9, 240])
@pytest.mark.parametrize("parts", [1, 2, 3, 5])
@pytest.mark.parametrize("apart", [0.05, 0.08, 0.1, 0.2, 0.3, 0.5, 0.8])
def test_late_keys_in_parts_move_nothing(count: int, parts: int, apart: float) -> None:
    """TCP repeats lost segments a round trip apart, or more; the keys of each come together."""
    steering = Steering(lambda: True)
    for number in range(count):
        now = 10.0 + number * 1e-4 + (number * min(parts, count) // count) * apart
        steering.press("up", now)
        assert steering.at(now) == (0.0, 0.0)


def test_a_stop_counts_at_once_behind_a_multiplexer() -> None:
    assert not moves(("up", 10.0), ("up", 10.5), ("up", 10.53), ("space", 10.531), at=10.531)


# -- on a line that brings keys in bunches, as mosh does

PAUSE = 0.5
GAP = 0.01


def held(seconds: float, repeat: float = 0.033, pause: float = PAUSE) -> list[float]:
    """Return when a terminal sends a key that is held for some seconds."""
    return [0.0, *(pause + number * repeat for number in range(int((seconds - pause) / repeat)))]


def bunched(keys: list[float], every: float, shaken: float = 0.0) -> list[float]:
    """Return when keys arrive over a line that carries them each `every` s, or later by up to a share of it."""
    draw = random.Random(1)
    carried = [0.013]
    while carried[-1] < keys[-1]:
        carried.append(carried[-1] + every * (1 + shaken * draw.random()))
    return [next(at for at in carried if at >= key) for key in keys]


class Drive:
    """A drive by the keys of one direction behind a multiplexer, in which the screen looks each 0.01 s.

    Attributes:
        moving: the times (s) at which the robot moved.
    """

    def __init__(self, arrivals: list[float], lasts: float) -> None:
        self.steering = Steering(lambda: True)
        self.moving: list[float] = []
        self.waits_at = self.broken_at = 0.0
        waiting = sorted(arrivals)
        for hundredths in range(int(lasts * 100)):
            now = hundredths * GAP
            while waiting and waiting[0] <= now:
                self.steering.press("up", 10.0 + waiting.pop(0))
            if self.steering.at(10.0 + now) != (0.0, 0.0):
                self.moving.append(now)
            self.waits_at = now if self.steering.waits(10.0 + now) else self.waits_at
            self.broken_at = now if self.steering.rhythm.is_broken else self.broken_at

    @property
    def is_whole(self) -> bool:
        """Whether the motion did not stop between its begin and its end."""
        return len(self.moving) == round((self.moving[-1] - self.moving[0]) / GAP) + 1


@pytest.mark.parametrize("shaken", [0.0, 0.3])
@pytest.mark.parametrize("repeat", [0.025, 0.033, 0.04, 0.09])
@pytest.mark.parametrize("every", [0.001, 0.03, 0.1, 0.2, 0.25])
def test_key_held_through_bunches_drives(every: float, repeat: float, shaken: float) -> None:
    keys = held(8.0, repeat)
    drive = Drive(bunched(keys, every, shaken), 12.0)
    assert drive.is_whole
    assert drive.moving[0] < PAUSE + 0.3 + 7 * every
    assert drive.moving[-1] < keys[-1] + LASTS + every * (1 + shaken) + 2 * GAP


@pytest.mark.parametrize("pause", [0.25, 0.66])
@pytest.mark.parametrize("every", [0.1, 0.2])
def test_pause_of_any_keyboard_begins_motion(every: float, pause: float) -> None:
    drive = Drive(bunched(held(5.0, pause=pause), every), 7.0)
    assert drive.is_whole
    assert drive.moving[0] < pause + 7 * every


@pytest.mark.parametrize("every", [0.1, 0.2])
def test_tapped_keys_move_nothing(every: float) -> None:
    assert not Drive(bunched([number * 0.3 for number in range(20)], every), 8.0).moving


@pytest.mark.parametrize("hang", [2.0, 14.0])
@pytest.mark.parametrize("seconds", [0.1, 1.0, 3.0, 14.0])
def test_what_waited_for_line_moves_nothing(seconds: float, hang: float) -> None:
    """A key that is held on for as long as the line hangs has to be let go."""
    late, still_held = [hang] * len(held(seconds)), bunched([hang + each for each in held(4.0, pause=0.033)], 0.1)
    assert not Drive(late, hang + 3.0).moving
    drive = Drive([*late, *still_held], hang + 6.0)
    assert not drive.moving
    assert drive.waits_at > hang + 3.0
    assert drive.broken_at > hang + 3.0


@pytest.mark.parametrize("trip", [0.05, 0.1, 0.16, 0.2, 0.3, 0.5])
@pytest.mark.parametrize(
    "counts", [(1, 2, 4, 8, 16, 32, 64), (1, 2, 3, 4, 5, 6, 7, 8), (1, 2, 4, 5, 6, 7, 8), (1, 1, 2, 4, 8)]
)
def test_late_keys_of_slow_start_move_nothing(counts: tuple[int, ...], trip: float) -> None:
    """What TCP sends again, each round trip a larger part."""
    assert not Drive([14.0 + trip * part for part, keys in enumerate(counts) for _ in range(keys)], 22.0).moving


@pytest.mark.parametrize(("gap", "breaks"), [(0.4, False), (0.8, True)])
@pytest.mark.parametrize("every", [0.1, 0.2])
def test_motion_resumes_after_short_gap(every: float, gap: float, breaks: bool) -> None:
    arrivals = [3.0 + gap if 3.0 < each < 3.0 + gap else each for each in bunched(held(8.0), every)]
    drive = Drive(arrivals, 10.0)
    assert drive.is_whole is not breaks
    assert drive.moving[-1] > 8.0


def test_long_gap_asks_for_key_held_anew() -> None:
    arrivals = [5.0 if 3.0 < each < 5.0 else each for each in bunched(held(8.0), 0.1)]
    again = [9.0 + each for each in bunched(held(3.0), 0.1)]
    drive = Drive([*arrivals, *again], 14.0)
    assert not [now for now in drive.moving if 3.0 + LASTS + 0.1 < now < 9.5]
    assert drive.moving[-1] > 12.0


def test_paste_of_keys_stops_motion() -> None:
    drive = Drive([*bunched(held(3.0), 0.1), *[2.95] * 60], 5.0)
    assert drive.moving[-1] < 2.95 + GAP
    assert drive.steering.rhythm.is_broken is False
