"""The domains of these tests, which no other run has.

CI runs other folders at the same time.
"""

from __future__ import annotations

from tests.support.locks import two_domains

DOMAIN = two_domains()
ANOTHER = DOMAIN + 1
