"""The program with the long lease of tests/engine/conftest.py, for bridges that are processes of their own."""

from __future__ import annotations

import sys

import pytest
from tests.support.long_lease import lengthen_lease

from rsb_console.cli import main

lengthen_lease(pytest.MonkeyPatch())
sys.exit(main())
