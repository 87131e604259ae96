"""The scheduler of a link without streams."""

from __future__ import annotations

import asyncio

from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.window import ReceiptBook, Window


def lone_scheduler() -> Scheduler:
    return Scheduler(ReceiptBook(asyncio.get_running_loop(), lambda _: None), Window())
