"""The domains of these tests, which no other run has: not even of another folder, beside which CI runs this one."""

from __future__ import annotations

from tests.support.locks import two_domains

DOMAIN = two_domains()
ANOTHER = DOMAIN + 1
