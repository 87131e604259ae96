"""Helpers of `test_printing` and others."""

from __future__ import annotations

EVIL = "\x1b]0;evil\x07\x1b[2J\u202eevil\u200b\x9b31m\n2026-01-01 forged\r\U000e0041"
