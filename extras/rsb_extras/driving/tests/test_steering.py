"""What keys mean and for how long, and which of them come too late to mean anything."""

import pytest
from textual.binding import Binding

from rsb_console.actions.all_actions import BY_ID
from rsb_extras.driving.drive_screen import _STOPS, _WAYS, DriveScreen, Steering

LABELS = {
    "up": "↑", "down": "↓", "left": "←", "right": "→", "comma": ",", "full_stop": ".",
    "plus": "+", "equals_sign": "+", "minus": "-", "escape": "esc",
}  # fmt: skip


def test_all_keys_are_in_the_help() -> None:
    (chapter,) = BY_ID["drive"].chapters
    listed = "".join(keys for keys, _ in chapter.keys)
    bound = [binding.key for binding in DriveScreen.BINDINGS if isinstance(binding, Binding)]
    keys = {key for each in bound for key in each.split(",")} | {*_WAYS, *_STOPS}
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
