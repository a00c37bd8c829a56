"""Figures of web pages on a machine that may be too busy: what could not be measured is None."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any

from playwright.sync_api import Error, Page


class FigureMissing(Exception):
    """A page did not give what a figure is computed from; the sentence says what."""


def measured(measure: Callable[[], float | tuple[float, ...]], *names: str) -> dict[str, float | None]:
    """What `measure()` returns, by the figures' names, in their order.

    Where a page did not load in time or lost what it had counted, each is None, and a line on stdout says
    which and why. Any other error is a defect of the measurement and is raised.
    """
    try:
        values = measure()
    except (FigureMissing, Error) as error:
        reason = str(error).partition("\n")[0]
        for name in names:
            print(f"{name} is missing: {reason}")
        return dict.fromkeys(names)
    return dict(zip(names, values if isinstance(values, tuple) else (values,), strict=True))


def kept(page: Page, name: str) -> Any:
    """The value of `window.<name>`, which a script put there. Raises FigureMissing where it is gone."""
    value = page.evaluate(f"window.{name}")
    if value is None:
        raise FigureMissing(f"the page lost window.{name}: it was loaded again while it was watched")
    return value


def wait_seen(page: Page, path: str) -> None:
    """Until `window.seen` has a time for `path`. Raises FigureMissing where the page was loaded again."""
    page.wait_for_function(f"!window.seen || window.seen['{path}'] !== undefined")
    kept(page, "seen")


def latency_ms(published_ms: Mapping[str, float], seen_ms: Mapping[str, float]) -> tuple[float, float]:
    """Median and 95th percentile from the publication of each path to when it was seen, in ms.

    Raises FigureMissing with fewer than two of them: there is no percentile then.
    """
    took_ms = [seen_ms[path] - sent for path, sent in published_ms.items() if path in seen_ms]
    if len(took_ms) < 2:
        raise FigureMissing(
            f"the page showed {len(took_ms)} of the {len(published_ms)} events that were heard on the bus"
        )
    return statistics.median(took_ms), statistics.quantiles(took_ms, n=20)[-1]
