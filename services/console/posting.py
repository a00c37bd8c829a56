"""What is wrong with a task before it costs anything, for the form and for programs, and who can be named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rodeo.bus.messages import Task
from rodeo.bus.queries import Offer
from rodeo.commands.tasks import RegisterTask
from rodeo.display.formatting import iec, party
from rodeo.kinds import Kinds
from rodeo.site.config import Site

MIN_WINDOW_S = 60


def problems(site: Site, kinds: Kinds, request: RegisterTask) -> dict[str, str]:
    """Field -> what to do about it; empty when the task can be posted here.

    The bridge checks what only the chain knows (prices, funds, kinds) before it sends anything.
    """
    wrong: dict[str, str] = {}
    kind = kinds.get(request.kind)
    if kind is not None and kind.price_iec and request.reward_iec <= 0:
        wrong["reward_iec"] = "offer more than 0 IEC"
    if request.execution_window_s is not None and request.execution_window_s < MIN_WINDOW_S:
        wrong["execution_window_s"] = f"give the executor at least {MIN_WINDOW_S} s"
    if kind is not None:
        params = kinds.completed(request.kind, request.params)
        wrong |= {f"params.{field}": text for field, text in kind.wrong_params(site, params).items()}
    return wrong


def fitting(task: Task, services: Sequence[Offer]) -> dict[str, str]:
    """The services that could be given an open task now, as a form's values and texts."""
    passed = {one.provider for one in task.passed}
    return {
        str(one.id): _offer(one)
        for one in services
        if one.kind == task.kind
        and one.state == "active"
        and one.task_id is None
        and one.price_iec <= task.reward_iec
        and one.provider not in passed
        and task.requested_service_id in (None, one.id)
        and task.requested_provider in (None, one.provider)
    }


def hireable(services: Sequence[Offer], of_kind: str | None) -> dict[str, str]:
    """The services and providers that can be named for a task of this kind, as the form's value and its
    text: each service that still takes tasks and may be named, and each provider that has several."""
    there = [
        one
        for one in services
        if one.kind == of_kind and one.state in ("active", "paused") and one.namers != "nobody"
    ]
    count = Counter(one.provider for one in there)
    several = {
        one.provider: f"any of {party(one.provider_name, one.provider)} ({count[one.provider]} services)"
        for one in there
        if count[one.provider] > 1
    }
    return several | {
        str(one.id): _offer(one) + (", paused" if one.state == "paused" else "") for one in there
    }


def _offer(one: Offer) -> str:
    return f"{one.id}: {party(one.provider_name, one.provider)}, {iec(one.price_iec)}"


def hired(value: str) -> dict[str, Any]:
    """The request's fields for a value of `hireable`."""
    return {"provider": value} if value.startswith("0x") else {"service_id": int(value)}
