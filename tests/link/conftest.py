"""Fixtures of tests on virtual time, and tests that are coroutines."""

from tests.support.coroutines import pytest_pyfunc_call
from tests.support.offline import context, loop, make_context

__all__ = ["context", "loop", "make_context", "pytest_pyfunc_call"]
