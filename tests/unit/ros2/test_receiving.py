"""What arrives is handed to Python in the receiving thread, which Python gets to know once."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from contextlib import ExitStack

import pytest
import zenoh

from rodeo.bus import receiving
from rodeo_testing.waiting import HANG_S
from tests.support.site import free_port


def opened(stack: ExitStack, connect: list[str], listen: list[str]) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps(connect))
    config.insert_json5("listen/endpoints", json.dumps(listen))
    return stack.enter_context(zenoh.open(config))


def test_python_keeps_a_receiving_thread_between_two_messages() -> None:
    seen: list[tuple[int, int | None, str]] = []
    local, arrived = threading.local(), threading.Semaphore(0)

    def take(sample: zenoh.Sample) -> None:
        before = getattr(local, "count", None)
        local.count = (before or 0) + 1
        seen.append((threading.get_native_id(), before, sample.payload.to_string()))
        arrived.release()

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        sender, receiver = opened(stack, [], [endpoint]), opened(stack, [endpoint], [])
        receiver.declare_subscriber("a/b", receiving.direct(take))
        publisher = sender.declare_publisher("a/b")
        while not publisher.matching_status.matching:
            threading.Event().wait(0.01)
        for number in range(20):
            publisher.put(str(number))
            assert arrived.acquire(timeout=HANG_S)
    assert [text for _, _, text in seen] == [str(number) for number in range(20)], "in their order"
    threads = {thread for thread, _, _ in seen}
    assert threading.get_native_id() not in threads
    for thread in threads:
        counts = [before for one, before, _ in seen if one == thread]
        assert counts == [None, *range(1, len(counts))], "what is local to the thread stays"


def test_the_end_of_a_query_is_told_after_its_answers() -> None:
    told: list[str] = []
    ended = threading.Event()
    with ExitStack() as stack:
        session = opened(stack, [], [])
        session.declare_queryable("q", lambda query: query.reply("q", "yes"))
        session.get("q", receiving.direct(lambda reply: told.append(reply.ok.payload.to_string()), ended.set))
        assert ended.wait(HANG_S)
    assert told == ["yes"]


SESSIONS = """
import json, threading, zenoh
from contextlib import ExitStack
from rodeo.bus import receiving
from tests.unit.ros2.test_receiving import HANG_S, free_port, opened
for _ in range(5):
    endpoint, heard = f"tcp/127.0.0.1:{free_port()}", threading.Event()
    with ExitStack() as stack:
        sender, receiver = opened(stack, [], [endpoint]), opened(stack, [endpoint], [])
        receiver.declare_subscriber("a/b", receiving.direct(lambda _sample: heard.set()))
        while not heard.wait(0.01):
            sender.put("a/b", "x")
print("over")
"""


@pytest.mark.long
def test_a_process_whose_receiving_threads_have_ended_ends() -> None:
    done = subprocess.run([sys.executable, "-c", SESSIONS], capture_output=True, text=True, timeout=HANG_S)
    assert (done.returncode, done.stdout) == (0, "over\n"), done.stderr
