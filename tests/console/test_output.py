"""The log's writer, on a real pipe: nothing waits for its reader, and what is lost is counted."""

import os
import select
import threading

from tests.support.waiting import eventually

from rsb_console.command.headless import TOO_SLOW, WAITING_LIMIT, LogWriter


def lost_line(lost: int, reason: str) -> str:
    return f"{lost} lost: {reason}"


def test_late_reader_gets_newest_and_count_of_missing() -> None:
    reader, pipe = os.pipe()
    writer = LogWriter(pipe, lost_line)
    writer.write("x" * (1 << 17))  # more than a pipe holds: what follows has to wait
    eventually(lambda: not select.select([], [pipe], [], 0)[1], what="the pipe is full")
    count = 2 * WAITING_LIMIT // 1000
    for number in range(count):
        writer.write(f"{number:0999}")
    content = bytearray()

    def read() -> None:
        while part := os.read(reader, 1 << 16):
            content.extend(part)

    thread = threading.Thread(target=read)
    thread.start()
    writer.close(60.0)
    os.close(pipe)
    thread.join()
    os.close(reader)
    lines = content.decode().splitlines()[1:]
    (said,) = [line for line in lines if "lost" in line]
    numbers = [int(line) for line in lines if line != said]
    assert said == f"{count - len(numbers)} lost: {TOO_SLOW}"
    assert numbers[-1] == count - 1
    assert numbers[lines.index(said) :] == list(range(count - len(numbers[lines.index(said) :]), count))
    assert WAITING_LIMIT - 2000 < len(numbers[lines.index(said) :]) * 1000 <= WAITING_LIMIT


def test_a_writer_that_is_stuck_is_left_behind() -> None:
    reader, pipe = os.pipe()
    before = set(threading.enumerate())
    writer = LogWriter(pipe, lost_line)
    (thread,) = (each for each in set(threading.enumerate()) - before if each.name == "log-writer")
    writer.write("x" * (1 << 20))
    writer.write("more")
    writer.close(0.01)
    os.close(reader)  # the write ends, with an error
    thread.join(60.0)
    assert not thread.is_alive()
    os.close(pipe)
