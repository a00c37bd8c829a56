"""Futures, and coroutines that the executor carries on when what they wait for is there."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator
from typing import Any


class Future:
    """Done once, by the thread that spins."""

    def __init__(self, *, executor: Any = None) -> None:
        self._done, self._result, self._exception = False, None, None
        self._callbacks: list[Callable[[Any], Any]] = []

    def __await__(self) -> Generator[Future, None, Any]:
        while not self._done:
            yield self
        return self.result()

    def done(self) -> bool:
        return self._done

    def result(self) -> Any:
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        return self._exception

    def set_result(self, result: Any) -> None:
        self._result = result
        self._end()

    def set_exception(self, exception: BaseException) -> None:
        self._exception = exception
        self._end()

    def add_done_callback(self, callback: Callable[[Any], Any]) -> None:
        if self._done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def _end(self) -> None:
        self._done = True
        for callback in self._callbacks:
            callback(self)
        self._callbacks.clear()


def run(coroutine: Coroutine[Any, Any, Any], later: Callable[[Callable[[], None]], None]) -> None:
    """Carry a coroutine on until it waits. What it raises ends whoever spins, as in rclpy."""
    try:
        awaited = coroutine.send(None)
    except StopIteration:
        return
    awaited.add_done_callback(lambda _: later(lambda: run(coroutine, later)))
