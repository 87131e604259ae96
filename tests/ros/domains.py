"""The domains of these tests, which no other run has.

CI runs other folders at the same time.
"""

from __future__ import annotations

from tests.support.locks import domains_of

DOMAIN = domains_of("nodes")
ANOTHER = DOMAIN + 1
