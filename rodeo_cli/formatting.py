"""Errors, times and amounts as people read them in a terminal."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from decimal import Decimal
from typing import Any, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from rodeo.display.formatting import FIELD_ADVICE, in_eur, number, phrase, span
from rodeo.errors import RodeoError
from rodeo.site.config import Site
from rodeo.text.pydantic_words import MISSING

_SENTENCES = {
    "not_creator": "only the task's creator may do this",
    "not_executor": "only the task's executor may do this",
    "not_provider": "only the service's provider may change it; who is paid for its work may withdraw it",
    "not_payout": "only the present payout address may set another one",
    "no_payout": "somebody has to be paid",
    "not_device_owner": "only the device's owner may do this",
    "not_member": "only members may do this",
    "not_judge": "this participant does not judge tasks of this kind",
    "judge_is_party": "a task's creator and executor, their owners and owners' devices may not judge it",
    "judge_is_auditor": "whoever passes a case on may not be an auditor, who would then decide it",
    "not_in_role": "this participant does not judge tasks of this kind",
    "not_passed_on": "only the judge of this kind may rule: it has passed nothing on",
    "passed_on_before": "the judge has passed this on, so only an auditor may rule on it",
    "ruling_stands": "the ruling can still be replaced: it is too early to conclude it",
    "case_over": "it is too late for this",
    "key_not_proven": "the key has not signed that it sits for this owner",
    "wrong_state": "the task's state does not allow this",
    "unknown_task": "there is no such task",
    "unknown_service": "there is no such service",
    "unknown_device": "there is no such device",
    "no_ruling": "there is no ruling yet",
    "nothing_owed": "the organization owes this account nothing",
    "service_not_idle": "the service still has tasks to do",
    "provider_is_asleep": "after work that was missed or given back it is too early to offer work again",
    "provider_is_awake": "the provider neither sleeps nor rests",
    "bond_is_locked": "a newcomer has its bonds back a day after it gave back or missed work",
    "service_does_not_fit": "the service is busy, rests, costs too much, or does not do this task",
    "not_namable": "the service takes no tasks of this creator that name it",
    "too_many_voids": "too many of this creator's tasks that named somebody ended void for this service",
    "invalid_window": "the kind of work has no such execution window",
    "invalid_windows": "execution windows are from a minute to 30 days, and the shortest comes first",
    "invalid_grace": "a grace period is a multiple of 10 s, at most half of the shortest execution window",
    "kind_without_windows": "the shortest and the longest execution window of this kind are not set yet",
    "provider_is_suspended": "the organization has suspended the provider",
    "provider_not_suspended": "the provider is not suspended",
    "service_is_retired": "the service was withdrawn for good",
    "service_is_suspended": "the organization has suspended the service",
    "device_name_taken": "another key has this role and name",
    "device_already_registered": "this key is already registered",
    "device_already_revoked": "this key was revoked earlier",
    "already_accepted": "this attempt is accepted already",
    "deadline_passed": "it is too late for this",
    "deadline_not_passed": "it is too early for this",
    "access_control_unauthorized_account": "the account lacks the required role",
    "over_budget": "all who hold the role together have a budget, and this is more than what is left of it",
    "reward_below_price": "every service of this kind costs more than the reward",
    "nonce_used": "this was posted or revoked already: a signed request can be sent once",
    "not_signed_by": "the participant has not signed this, or it was changed afterwards",
    "request_expired": "the signed request has expired",
    "tasks_are_paused": "a guardian has paused new tasks",
    "paused_recently": "the last pause was too recent for another one",
    "too_few_members": "members vote only if there are three, and while they vote three have to remain",
    "not_a_contract": "only a contract can have this role, not an account with a key",
    "role_without_budget": "only operators and treasurers have budgets",
    "challenged_before": "somebody has challenged this ruling already, and only a party may take that over",
    "another_ruling": "another ruling stands by now: look at it, and challenge that one",
    "neither_party_nor_judge": "only the task's parties and judges may challenge its ruling",
    "no_case": "nobody has ruled in a way that can be challenged, or the stakes are settled already",
    "window_over": "it is too late for this",
    "window_not_over": "it is too early for this",
    "withdrawal_too_early": "it is too early for this",
    "no_withdrawal": "nobody has announced that this stake is to be withdrawn",
    "stake_too_low": "the stake of a judge is too low for its vote to count: somebody has to deposit",
    "not_owner": "only the owner of the judge may do this",
    "governor_already_cast_vote": "this account has voted already",
    "governor_insufficient_proposer_votes": "the account has too few votes to propose anything",
    "governor_unexpected_proposal_state": "the proposal's state does not allow this",
}
"""Sentences for errors of contracts and the bridge, by name."""

_MOMENTS = frozenset({"until", "deadline", "time", "earliest", "needed", "revoked_at"})
"""Arguments of contracts' errors that are block times, if they are as large as one. So is all else in seconds
that is so large."""
_FIRST_MOMENT = 1_000_000_000

_LENGTHS = {"_s": span, "_m": lambda value: f"{value:g} m"}

_OPTION_OF_FIELD = {
    "allow_wait": "wait",
    "item_id": "item",
    "x_m": "item",
    "y_m": "item",
    "device": "address",
    "policy": "name",
    "kind": "name",
    "states": "state",
    "who": "participant",
}
"""Fields of requests that have another name on the command line."""

_UNFIT = re.compile(r"^the (request|answer) does not fit \w+$")
"""Message of `rodeo.bus.session.validate`, in words for programmers."""


def options_of(command: Callable[..., Any]) -> dict[str, str]:
    """Names of a Typer command's parameters as they are typed: `--item`, or `AMOUNT`."""
    called = {}
    for name, hint in get_type_hints(command, include_extras=True).items():
        for info in getattr(hint, "__metadata__", ()):
            if isinstance(info, ArgumentInfo):
                called[name] = (info.metavar or name.upper()).removesuffix("...")
            elif isinstance(info, OptionInfo):
                # Typer takes the first spelling for a default until the command is built.
                declared = [one for one in (info.default, *(info.param_decls or ())) if isinstance(one, str)]
                spellings = [one.partition("/")[0] for one in declared if one.startswith("--")]
                called[name] = spellings[0] if spellings else f"--{name.replace('_', '-')}"
    return called


def explain(error: RodeoError, options: dict[str, str]) -> str:
    """The error as a sentence: what was wrong, by the option that set it (`options_of` the command), and the
    values that explain it."""
    details = dict(error.details)
    fields = details.pop("fields", None)
    sentence = _SENTENCES.get(error.code, error.message)
    if sentence.startswith("the contract refused: "):
        sentence = f"the contract refused: {phrase(sentence.partition(': ')[2]).lower()}"
    if isinstance(fields, dict):
        wrong = list(dict.fromkeys(_wrong(str(name), str(text), options) for name, text in fields.items()))
        sentence = "; ".join(wrong) if _UNFIT.match(sentence) else f"{sentence}: {'; '.join(wrong)}"
    values = ", ".join(_value(name, value) for name, value in _shown(details).items())
    return f"{sentence} ({values})" if values else sentence


_TOGETHER = ("judge", "audit_window_s", "min_verdict_window_s", "max_verdict_window_s", "min_window_s",
             "max_window_s", "grace_s")  # fmt: skip
"""Fields that rules about several fields name."""


def _wrong(field: str, text: str, options: dict[str, str]) -> str:
    """The sentence that replaces a problem of one field."""
    field = field.removeprefix("params.")
    root = field.partition(".")[0]
    text = re.sub(r"^(Value error, |Input |String |Value )", "", text)
    option = next((options[name] for name in _names(root) if name in options), None)
    if option is None:
        # A rule about several fields names them in its sentence.
        for name, spelled in options.items():
            text = re.sub(rf"\b{re.escape(name)}\b", spelled, text) if name in _TOGETHER else text
        if root == "(whole)":
            return text
        if "params" not in options:
            return f"{field}: {_lowered(text)}"
        option = f"--{root.replace('_', '-')}"  # a parameter of the task's kind
    if text == MISSING:
        value = option.lstrip("-").replace("-", "_").upper()
        return f"pass {option} {value}" if option.startswith("-") else f"give {option}"
    return f"{option}: {FIELD_ADVICE.get(root, _lowered(text))}"


def _names(field: str) -> list[str]:
    return [field, field.removesuffix("_iec"), field.removesuffix("_s"), _OPTION_OF_FIELD.get(field, field)]


def _lowered(text: str) -> str:
    return text[:1].lower() + text[1:]


def _shown(details: dict[str, Any]) -> dict[str, Any]:
    """Without empty values, and without the address of an account that has a name."""
    named = bool(details.get("name"))
    return {
        name: value
        for name, value in details.items()
        if value not in (None, "", []) and not (name == "account" and named)
    }


def _value(name: str, value: Any) -> str:
    if name.endswith("_iec"):
        return f"{_plain(name.removesuffix('_iec'))}: {iec(value)}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        if value >= _FIRST_MOMENT and (name in _MOMENTS or name.endswith("_s")):
            return f"{_plain(name.removesuffix('_s'))}: {_date_and_time(value)} by the chain's clock"
        for unit, words in _LENGTHS.items():
            if name.endswith(unit):
                return f"{_plain(name.removesuffix(unit))}: {f'{value:g} s' if value < 60 else words(value)}"
    return f"{_plain(name)}: {plain(value)}"


def _plain(name: str) -> str:
    return name.replace("_", " ")


def plain(value: Any) -> str:
    """A value from JSON without the marks of JSON."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {plain(one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(plain, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def iec(amount: Decimal | str | None) -> str:
    """1,234.5 IEC; every digit of what is less than a hundredth."""
    value = Decimal(str(amount or 0))
    return f"{number(value, 18 if 0 < abs(value) < Decimal('0.01') else 2)} IEC"


def worth(amount: Decimal | str | None, site: Site) -> str:
    """`iec`, and what it is worth where the site names a rate."""
    return iec(amount) + in_eur(amount or 0, site)


def moment(time_s: float, site: Site) -> str:
    """Date and time, and whose: a simulated site has a time of its own, which may run faster than that of
    the wall."""
    zone = "UTC" if site.clock.source == "wall" else "(simulated time)"
    return f"{_date_and_time(time_s)} {zone}"


def _date_and_time(time_s: float) -> str:
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S}"
