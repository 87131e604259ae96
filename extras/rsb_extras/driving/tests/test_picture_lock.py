"""Keys do nothing while the camera's picture in sight is old."""

from __future__ import annotations

import math

import pytest
from tests.support.wording import says

from rsb_console.feature_console import CameraSight
from rsb_extras.driving.picture_lock import LockText, PictureLock, read_picture_age

MOST = 1.0


class Camera:
    """A picture whose age and stillness a test sets."""

    def __init__(self) -> None:
        self.sight: CameraSight | None = CameraSight(0.2)
        self.lock = PictureLock(lambda: self.sight, MOST)

    def drives(self, began: float, ended: float, still: float = 0.0) -> list[float]:
        """Hold a key as the screen does, and return the times at which it moved the robot."""
        moved = []
        for number in range(round((ended - began) * 10)):
            now = began + number / 10
            age = 0.0 if self.sight is None or self.sight.age is None else self.sight.age
            if still:
                self.sight = CameraSight(age, still + now - began)
            moves = not self.lock.problem(now)
            self.lock.note_motion(now, moves=moves)
            moved += [now] if moves else []
        return moved


@pytest.mark.parametrize(
    ("sight", "text"),
    [
        (None, None),
        (CameraSight(0.0), None),
        (CameraSight(MOST), None),
        (CameraSight(MOST + 0.1), LockText.OLD),
        (CameraSight(None), LockText.UNKNOWN),
        (CameraSight(math.inf), LockText.OLD),
        (CameraSight(0.1, 60.0), None),  # a simulated camera whose robot stands
    ],
)
def test_old_picture_locks(sight: CameraSight | None, text: LockText | None) -> None:
    problem = PictureLock(lambda: sight, MOST).problem(5.0)
    assert says(problem, text) if text else problem == ""


def test_picture_that_stands_still_locks_once_robot_moves() -> None:
    camera = Camera()
    moved = camera.drives(10.0, 20.0, still=5.0)
    assert moved[0] == 10.0
    assert moved[-1] - moved[0] == pytest.approx(MOST + 0.2, abs=0.15)
    assert says(camera.lock.problem(20.0), LockText.FROZEN)
    camera.sight = CameraSight(0.2)
    assert camera.drives(21.0, 22.0)


def test_picture_that_changes_never_locks() -> None:
    camera = Camera()
    assert len(camera.drives(10.0, 20.0)) == 100


def test_age_stays_on_screen_for_a_second() -> None:
    camera = Camera()
    assert says(camera.lock.age(1.0), LockText.AGE, age=0.2)
    camera.sight = CameraSight(0.7)
    assert says(camera.lock.age(1.9), LockText.AGE, age=0.2)
    assert says(camera.lock.age(2.0), LockText.AGE, age=0.7)


def test_setting_of_zero_drives_by_any_picture() -> None:
    assert PictureLock(lambda: CameraSight(60.0), read_picture_age(0)).problem(1.0) == ""


@pytest.mark.parametrize("given", [True, "1", 0.05, -1, 61, None, math.nan])
def test_bad_setting_names_its_place(given: object) -> None:
    with pytest.raises(ValueError, match=r"^picture_age: "):
        read_picture_age(given)
