"""The table of an action's goals."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from tests.support.goals import goal

from rsb_bridge.route.calls.goals import MOST_GOALS, OVER, STATES, Goals, GoalStatus


class Wall:
    def __init__(self) -> None:
        self.time = 100.0

    def __call__(self) -> float:
        return self.time


def made(*states: tuple[int, str]) -> Goals:
    """Goals of this route that their server has listed so."""
    goals = Goals(Wall())
    for number, _ in states:
        goals.asked(goal(number))
    listed(goals, *states)
    return goals


def listed(goals: Goals, *states: tuple[int, str]) -> None:
    goals.listed([GoalStatus(goal(number), state) for number, state in states])


def states(goals: Goals) -> dict[int, str]:
    return {int(each.id, 16): each.state for each in goals.snapshot(set())}


def test_a_goal_from_its_request_to_its_result() -> None:
    wall = Wall()
    goals = Goals(wall)
    seen = []
    steps = (
        lambda: goals.asked(goal(1)),
        lambda: goals.answered(goal(1), accepted=True),
        lambda: listed(goals, (1, "executing")),
        lambda: listed(goals, (1, "canceling")),
        lambda: goals.result(goal(1), "canceled"),
    )
    for step in steps:
        wall.time += 1
        step()  # type: ignore[no-untyped-call]
        (now,) = goals.snapshot(set())
        assert now.since == wall.time
        seen.append(now.state)
    assert seen == ["asked", "accepted", "executing", "canceling", "canceled"]
    assert goals.is_over(goal(1))


def test_what_crosses_of_it_is_counted() -> None:
    goals = made((1, "executing"))
    goals.feedback(goal(1))
    goals.feedback(goal(1))
    goals.feedback(goal(2))  # which is unknown
    (one,) = goals.snapshot({goal(1)})
    assert (one.id, one.feedbacks, one.result_awaited) == (goal(1).hex(), 2, True)
    (one,) = goals.snapshot(set())
    assert not one.result_awaited


def test_messages_that_overtake_each_other_lead_nowhere_back() -> None:
    goals = made((1, "canceling"), (2, "succeeded"))
    goals.answered(goal(1), accepted=True)
    listed(goals, (1, "executing"), (2, "canceling"))
    goals.result(goal(2), "unknown")
    assert states(goals) == {1: "canceling", 2: "succeeded"}


def test_goals_of_other_callers_are_shown_while_running() -> None:
    goals = made((1, "executing"))
    listed(goals, (1, "executing"), (2, "executing"), (3, "succeeded"))
    assert states(goals) == {1: "executing", 2: "executing"}
    assert goals.running() == [goal(1)]


def test_goal_no_longer_listed_ends_unknown() -> None:
    goals = made((1, "executing"), (2, "executing"), (3, "succeeded"))
    goals.asked(goal(4))
    goals.answered(goal(4), accepted=True)
    listed(goals, (2, "executing"))
    assert states(goals) == {1: "unknown", 2: "executing", 3: "succeeded", 4: "accepted"}, "4 was never listed"


def test_departed_server_takes_knowledge_until_it_returns() -> None:
    goals = made((1, "executing"), (2, "aborted"))
    goals.server_gone()
    assert states(goals) == {1: "unknown", 2: "aborted"}
    assert not goals.is_over(goal(1))
    listed(goals, (1, "executing"), (2, "aborted"))
    assert states(goals) == {1: "executing", 2: "aborted"}


def test_goal_of_lost_call_is_unknown_until_listed() -> None:
    goals = made((2, "executing"))
    goals.asked(goal(1))
    goals.unanswered(goal(1))
    goals.unanswered(goal(2))  # whose acceptance came
    assert states(goals) == {1: "unknown", 2: "executing"}
    listed(goals, (1, "executing"), (2, "executing"))
    assert states(goals) == {1: "executing", 2: "executing"}


def test_running_goals_come_first_newest_first() -> None:
    goals = made((1, "succeeded"), (2, "executing"), (3, "aborted"), (4, "executing"))
    assert list(states(goals)) == [4, 2, 3, 1]


def test_those_that_are_over_are_forgotten_first() -> None:
    goals = made((1, "executing"), (2, "succeeded"), (3, "succeeded"))
    for number in range(4, MOST_GOALS + 2):
        goals.asked(goal(number))
    kept = states(goals)
    assert len(kept) == MOST_GOALS
    assert 1 in kept
    assert 2 not in kept
    assert 3 in kept
    for number in range(1000, 1000 + MOST_GOALS):
        goals.asked(goal(number))
    assert len(states(goals)) == MOST_GOALS
    assert 1 not in states(goals)


NUMBERS = st.integers(1, 4)
STATUS = st.lists(st.tuples(NUMBERS, st.sampled_from(STATES)), max_size=4)


@given(st.lists(st.one_of(NUMBERS, STATUS)))
def test_what_is_over_stays_over(events: list[int | list[tuple[int, str]]]) -> None:
    goals = Goals(Wall())
    over: dict[int, str] = {}
    for event in events:
        if isinstance(event, int):
            goals.asked(goal(event))
            goals.answered(goal(event), accepted=event % 2 == 0)
        else:
            listed(goals, *event)
        now = states(goals)
        assert over.items() <= now.items()
        over = {number: state for number, state in now.items() if state in OVER}
