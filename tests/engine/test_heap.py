"""A program's heap is left out of garbage collections once its engine has started, until it is frozen again."""

from __future__ import annotations

import gc
import weakref

from rsb_bridge.engine import freeze_heap


class _Engine:
    def __init__(self) -> None:
        self.itself = self


def test_heap_is_left_out_of_collections_until_it_is_frozen_again() -> None:
    engine = _Engine()
    gone = weakref.ref(engine)
    try:
        freeze_heap()
        assert gc.get_freeze_count()
        del engine
        gc.collect()
        assert gone() is not None
        freeze_heap()
        assert gone() is None
    finally:
        gc.unfreeze()
