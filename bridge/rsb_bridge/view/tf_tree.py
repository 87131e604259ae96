"""The frames of tf2_msgs/msg/TFMessage as a tree, with their ages, rates, and what is wrong."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording
from rsb_bridge.view.canvas import lines_to_cells
from rsb_bridge.view.drawing import Drawn, UndrawableError, View, elements, text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.pictures import Wish
    from rsb_bridge.view.drawing import TakenMessage

FRAMES = 1000
"""Frames that are remembered."""
_OLD = 1.0
"""s without a new transform after which a frame is late."""
_TIMES = 20
"""Newest times of a frame by which its rate is taken; as many parents and authors of it are remembered."""
_DEEPEST = 30
"""Steps by which a frame is indented at most."""

Line = list[tuple[str, str]]


class TreeProblem(Wording):
    """Faults of frames."""

    TOO_MANY = "more than {limit} frames: only the first ones are shown"
    TWO_PARENTS = "two parents: {parents}"
    TWO_AUTHORS = "published by two nodes: {authors}"
    AUTHOR = "by {author}"
    CIRCLE = "is its own ancestor"
    ROOTS = "the tree is in {count} parts, with the roots {roots}"
    NO_MATCH = "no frame contains {match!r}"


class _Frame:
    """One frame."""

    def __init__(self) -> None:
        self.parents: dict[str, float] = {}
        """Parents, with the time of their newest transform."""
        self.authors: dict[str, float] = {}
        """Nodes that publish it, with the time of their newest transform."""
        self.times: deque[float] = deque(maxlen=_TIMES)
        self.is_static = True


class TfTree(View):
    """Draws all frames that have come so far."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}
        self._newest = 0.0
        self._too_many = False

    def receive(self, received: TakenMessage) -> None:
        self._newest = max(self._newest, received.time)
        static = received.topic.endswith("tf_static")
        for each in elements(received.message, "transforms"):
            # As tf2 does, since older nodes begin the names of frames with a /.
            child, parent = (text(each, name).removeprefix("/") for name in ("child_frame_id", "header.frame_id"))
            frame = self._frames.get(child)
            if frame is None:
                if len(self._frames) >= FRAMES:
                    self._too_many = True
                    continue
                frame = self._frames[child] = _Frame()
            # A hostile node may give a frame any number of parents, each with a line of its own.
            if len(frame.parents) < _TIMES or parent in frame.parents:
                frame.parents[parent] = received.time
            if received.author and (len(frame.authors) < _TIMES or received.author in frame.authors):
                frame.authors[received.author] = received.time
            frame.times.append(received.time)
            frame.is_static = frame.is_static and static

    def draw(self, wish: Wish) -> Drawn:
        if not self._frames:
            return Drawn()
        children: dict[str, list[str]] = {}
        for name, frame in self._frames.items():
            for parent in frame.parents:
                children.setdefault(parent, []).append(name)
        roots = [parent for parent in children if parent not in self._frames]
        lines = [*self._lines(roots, children)]
        shown = {line[0][0].strip() for line in lines}
        circles = sorted(self._frames.keys() - shown)  # frames that are below no root
        lines += [[(name, "error"), (f"  {TreeProblem.CIRCLE()}", "error")] for name in circles]
        matching = [line for line in lines if wish.match in line[0][0]]
        if not matching:
            raise UndrawableError(TreeProblem.NO_MATCH(match=wish.match))
        first = max(0, min(len(matching) - 1, int(-wish.y * wish.height)))
        problem = TreeProblem.TOO_MANY(limit=FRAMES) if self._too_many else ""
        if len(roots) > 1:
            problem = problem or TreeProblem.ROOTS(count=len(roots), roots=", ".join(sorted(roots)[:8]))
        cells = lines_to_cells(matching[first : first + wish.height], wish.width, wish.height)
        return Drawn(cells, (f"{len(self._frames) + len(roots)} frames",), problem)

    def _lines(self, roots: Iterable[str], children: dict[str, list[str]]) -> Iterator[Line]:
        """Yield the lines of frames and of all below them, which are drawn below one of their parents only."""
        drawn: set[str] = set()
        # Backwards, because the last one is drawn first.
        waiting = [(root, 0) for root in sorted(roots, reverse=True)]
        while waiting:
            name, depth = waiting.pop()
            yield [(f"{'  ' * min(depth, _DEEPEST)}{name}", ""), *self._state(name)]
            if name not in drawn:
                drawn.add(name)
                waiting += [(child, depth + 1) for child in sorted(children.get(name, ()), reverse=True)]

    def _state(self, name: str) -> Line:
        now = max(self.now, self._newest)
        frame = self._frames.get(name)
        if frame is None:
            return []
        alive = [parent for parent, time in frame.parents.items() if frame.is_static or now - time < _OLD]
        if len(alive) > 1:
            return [(f"  {TreeProblem.TWO_PARENTS(parents=', '.join(alive))}", "error"), *self._author(frame, now)]
        if frame.is_static:
            return [("  static", "dim"), *self._author(frame, now)]
        age = now - frame.times[-1]
        span = frame.times[-1] - frame.times[0]
        rate = f"  {(len(frame.times) - 1) / span:.3g} Hz" if span > 0 else ""
        late = (f"  {age:.1f} s old", "warning" if age > _OLD else "dim")
        return [(rate, "dim"), late, *self._author(frame, now)]

    def _author(self, frame: _Frame, now: float) -> Line:
        """Return the nodes that publish a frame now, or the last one that did."""
        if not frame.authors:
            return []
        alive = [author for author, time in frame.authors.items() if frame.is_static or now - time < _OLD]
        if len(alive) > 1:
            return [(f"  {TreeProblem.TWO_AUTHORS(authors=', '.join(sorted(alive)))}", "warning")]
        newest = max(frame.authors, key=frame.authors.__getitem__)
        return [(f"  {TreeProblem.AUTHOR(author=newest)}", "dim")]
