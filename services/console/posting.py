"""What is wrong with a task before it costs anything: for the form, and for programs."""

from __future__ import annotations

from rodeo.config import Site
from rodeo.kinds import Kinds
from rodeo.messages import RegisterTask

MIN_WINDOW_S = 60


def problems(site: Site, kinds: Kinds, request: RegisterTask) -> dict[str, str]:
    """Field -> what to do about it; empty when the task can be posted here.

    What only the chain knows (prices, funds, kinds) the bridge checks before it sends anything.
    """
    wrong: dict[str, str] = {}
    kind = kinds.get(request.kind)
    if kind is not None and kind.price_iec and request.reward_iec <= 0:
        wrong["reward_iec"] = "offer more than 0 IEC"
    if request.execution_window_s is not None and request.execution_window_s < MIN_WINDOW_S:
        wrong["execution_window_s"] = f"give the executor at least {MIN_WINDOW_S} s"
    if kind is not None:
        wrong |= {f"params.{field}": text for field, text in kind.wrong_params(site, request.params).items()}
    return wrong
