"""Fixtures of tests on virtual time."""

from tests.support.offline import loop, make_context

__all__ = ["loop", "make_context"]
