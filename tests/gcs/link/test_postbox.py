"""What threads post arrives on the event loop: all of it, in order, with few wakes, whatever a receiver does."""

import asyncio
import threading
from typing import Any

from agents.shell.handover import PERIOD_S
from gcs.link.feed import PostedCalls
from tests.support.wire import PATIENCE_S, until

COUNT, THREADS = 2000, 4


def test_all_that_threads_post_is_taken_in_order_with_few_wakes() -> None:
    async def run() -> tuple[list[tuple[int, int]], int, float]:
        loop, taken, wakes = asyncio.get_running_loop(), list[tuple[int, int]](), [0]
        wake = loop.call_soon_threadsafe

        def counted(*arguments: Any) -> Any:
            wakes[0] += 1
            return wake(*arguments)

        loop.call_soon_threadsafe = counted  # type: ignore[method-assign, assignment]
        box, began_s = PostedCalls(gathers=True), loop.time()

        def post(thread: int) -> None:
            for number in range(COUNT):
                box.post(lambda *value: taken.append(value), thread, number)

        for each in [threading.Thread(target=post, args=(each,)) for each in range(THREADS)]:
            each.start()
        async with asyncio.timeout(PATIENCE_S):
            while len(taken) < THREADS * COUNT:
                await asyncio.sleep(0.001)
        return taken, wakes[0], loop.time() - began_s

    taken, wakes, took_s = asyncio.run(run())
    for thread in range(THREADS):
        assert [number for each, number in taken if each == thread] == list(range(COUNT))
    assert wakes <= took_s / PERIOD_S + 2


def test_what_a_receiver_posts_or_raises_keeps_nothing_from_the_others() -> None:
    async def run() -> tuple[list[str], list[str]]:
        taken, failures, loop = list[str](), list[str](), asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: failures.append(str(context["exception"])))
        box = PostedCalls(gathers=True)

        def fail() -> None:
            raise ValueError("broken")

        box.post(fail)
        box.post(box.post, taken.append, "posted while others were taken")
        box.post(taken.append, "behind the broken one")
        await until(lambda: len(taken) == 2)
        return taken, failures

    taken, failures = asyncio.run(run())
    assert taken == ["behind the broken one", "posted while others were taken"]
    assert failures == ["broken"]


def test_posts_after_the_loop_is_closed_are_no_error() -> None:
    async def box() -> PostedCalls:
        return PostedCalls(gathers=True)

    asyncio.run(box()).post(print, "not printed")
