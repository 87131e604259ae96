"""Fixtures of tests on virtual time."""

from hypothesis import settings
from tests.support.offline import loop, make_context

__all__ = ["loop", "make_context"]

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")
