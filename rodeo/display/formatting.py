"""Numbers, times and errors as people read them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from decimal import Decimal
from typing import Any

from rodeo.bus.messages import PROVEN_FROM, Fault, Task
from rodeo.bus.queries import BudgetBallot, BudgetVote, KindRules, Known, Offer, ProposedCall
from rodeo.errors import RodeoError, snake_case
from rodeo.judging.verdicts import FAULTS
from rodeo.site.config import Site

STATE_COLOURS = {
    "open": "warn",
    "assigned": "info",
    "submitted": "brand",
    "ruled": "warn",
    "settled": "good",
    "failed": "bad",
    "cancelled": "",
    "active": "good",
    "paused": "warn",
    "retired": "",
    "suspended": "bad",
    "short": "warn",
    "ready": "good",
    "not ready": "warn",
    "lost": "bad",
    "silent": "",
    "accepted": "good",
    "rejected": "bad",
    "expired": "bad",
    "abandoned": "warn",
    "given up": "warn",
    "impossible": "warn",
    "undecided": "warn",
    "void": "warn",
    "paid": "good",
    "superseded": "",
    "compromised": "bad",
}
"""The class of a badge that shows this word."""

_ADVICE = {
    "no_responder": "Check on the overview that the bridge is running, then try again.",
    "query_timeout": "It may still happen. Check whether it did before you try again.",
    "bridge_not_ready": "The overview shows why. Try again when the bridge is ready.",
    "insufficient_funds": "Deposit IEC under Treasury, or choose a smaller amount.",
    "reward_below_price": "Raise the reward, or let the task wait for a cheaper service.",
    "invalid_window": "Choose a time to do it within the kind's, which the rules under Services show.",
    "service_does_not_fit": "Choose another service, or wait until this one is free.",
    "provider_is_asleep": "It rests after work that it gave back or missed. Try again then.",
    "not_namable": "Let the policy choose, or name another service.",
    "unknown_kind": "An administrator can allow this kind of work.",
    "kind_without_checks": "Let an auditor judge it.",
    "device_name_taken": "Revoke the key that has this name first, or choose another name.",
    "invalid_amount": "Pay more than nothing and at most the agreed price.",
    "bad_amount": "Pay more than nothing and at most the agreed price.",
    "cannot_do": "Choose a participant who can do this work.",
    "already_offered": "Change the price or the state of that service under Services.",
    "judge_is_party": "Another auditor has to judge it.",
    "robot_unavailable": "Check on the overview that the robot's agent is running.",
    "forbidden": "Ask an administrator for the role.",
    "unknown_command": "This site's bridge is too old for this action.",
    "unknown_query": "This site's bridge is too old for this action.",
    "nothing_to_cancel": "Reload the page: it may have finished.",
    "wrong_state": "Its state has changed. The page shows the present state.",
    "unknown_task": "Look for its number under Tasks.",
    "unknown_participant": "Participants are listed under Services; or give an address (0x…).",
    "store_unavailable": "Check that the site's store can be reached, then try again.",
}
"""What to do about an error, by its code."""

_UNFIT = "the request does not fit"
"""How `rodeo.bus.session.validate` begins what it says of a request."""

_AMOUNT = "enter an amount of IEC, for example 12.5"
_PARTY = "enter a participant's name or an address (0x and 40 hex digits)"
FIELD_ADVICE = {
    "reward_iec": _AMOUNT,
    "price_iec": _AMOUNT,
    "amount_iec": _AMOUNT,
    "bond_iec": _AMOUNT,
    "penalty_iec": _AMOUNT,
    "max_failures": "enter a whole number from 0 to 255",
    "device": "enter the key's address: 0x and 40 hex digits",
    "owner": _PARTY,
    "account": _PARTY,
    "to": _PARTY,
    "kind": "begin with a small letter; small letters, digits and _ only, at most 31",
    "name": "letters, digits, dots, dashes and _ only, at most 64",
    "participant": "enter the name of a participant of this site",
    "passphrase": "use 12 to 256 characters",
    "current": "enter the passphrase you log in with",
    "label": "enter its purpose in 1 to 64 characters",
    "note": "describe your work in at most 4,000 characters",
    "reason": "give a reason of at most 500 characters",
    "rules_sha256": "enter a hash: 0x and 64 hex digits, small letters",
    "max_attempts": "enter a whole number from 1 to 255",
    "audit_window_s": "enter seconds, at most 30 days together with the verdict window",
    "min_verdict_window_s": "enter seconds, from a minute to 30 days",
    "max_verdict_window_s": "enter seconds, from a minute to 30 days",
    "execution_window_s": "give the executor at least a minute, and at most 30 days",
    "min_window_s": "enter seconds, from a minute to 30 days, and at most the longest window",
    "max_window_s": "enter seconds, from a minute to 30 days",
    "grace_s": "enter tens of seconds, at most 2550 s and half of the shortest window",
    "reference_price_iec": "enter a price in IEC, greater than 0",
    "max_void_percent": "enter a whole number from 0 to 100",
    "service_id": "enter the number of a service",
}
"""What to enter, by the field's name: the framework's own words are for programs."""


def explain(error: RodeoError) -> str:
    """The error and what to do about it."""
    sentence, fields = error.message, error.details.get("fields")
    wrong = ""
    if isinstance(fields, dict):
        advice: dict[str, str] = {}
        if sentence.startswith(_UNFIT):
            sentence, advice = "correct this and try again", FIELD_ADVICE
        wrong = "; ".join(
            f"{name.replace('_iec', '').replace('_', ' ')}: {advice.get(name, text)}"
            for name, text in fields.items()
        )
    parts = [sentence[:1].upper() + sentence[1:], wrong, _ADVICE.get(error.code, "")]
    return ". ".join(part.rstrip(".") for part in parts if part) + "."


def iec(amount: Decimal | str | float | None) -> str:
    """1,234.5 IEC; less than a hundredth with every digit, so that it never reads as nothing."""
    if amount is None:
        return "–"
    value = Decimal(str(amount))
    return exact(value) if 0 < abs(value) < Decimal("0.01") else f"{number(value)} IEC"


def worth(amount: Decimal | str | float | None, site: Site) -> str:
    """`iec`, and what it is worth where the site names a rate: 1,234.6 IEC (61.73 EUR)."""
    return iec(amount) + in_eur(amount, site)


def in_eur(amount: Decimal | str | float | None, site: Site) -> str:
    """What follows an amount in IEC; empty where the site names no rate."""
    rate = site.economy.eur_per_iec
    return "" if rate is None or amount is None else f" ({Decimal(str(amount)) * rate:,.2f} EUR)"


def exact(amount: Decimal) -> str:
    """1,234.5678 IEC: with every digit, where somebody agrees to it."""
    return f"{number(amount, 18)} IEC"


def number(value: Decimal, digits: int = 2) -> str:
    """With thousands separated and no zeros at the end."""
    text = f"{value:,.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def phrase(name: str) -> str:
    """TaskSettled -> Task settled, NotAJudge -> Not a judge"""
    return snake_case(name).replace("_", " ").capitalize()


def count(number_of: int, one: str) -> str:
    """1 transfer, 2 transfers"""
    return f"{number_of:,} {one}{'' if number_of == 1 else 's'}"


def process(name: str) -> str:
    """robot_agent.panther1 -> robot agent panther1; what the site file names keeps its name"""
    role, _, instance = name.partition(".")
    return f"{kind(role)} {instance}".rstrip()


def kind(name: str) -> str:
    return name.replace("_", " ")


def parameter(name: str) -> str:
    """x_m -> x (m)"""
    plain, _, unit = name.rpartition("_")
    return f"{plain} ({unit})" if plain and unit in ("m", "s", "rad") else name.replace("_", " ")


def moment(time_s: float | None) -> str:
    """Site time as date and time (UTC)."""
    return "–" if time_s is None else f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S}"


def wall_moment(time_s: float | None) -> str:
    """A moment of wall time, not of a simulated site's."""
    return "–" if time_s is None else f"{moment(time_s)} UTC"


def zone(site: Site) -> str:
    """What follows the time of a site, where the wall's time stands beside it."""
    return "UTC" if site.clock.source == "wall" else "UTC sim"


def share(value: float | None) -> str:
    return "–" if value is None else f"{value:.0%}"


def short(text: str, head: int = 10, tail: int = 6) -> str:
    """An address or hash whose ends people compare."""
    return text if len(text) <= head + tail + 1 else f"{text[:head]}…{text[-tail:]}"


def brief(text: str) -> str:
    """A text whose hashes and addresses are cut as `short` does."""
    return re.sub(r"0x[0-9a-fA-F]{20,}", lambda found: short(found[0]), text)


def party(name: str | None, address: str | None) -> str:
    """Whoever it is, as well as it is known."""
    return name or (short(address) if address else "–")


def calls_in_words(calls: Iterable[ProposedCall]) -> str:
    """What a proposal would call, by contract, function and arguments."""
    return "; ".join(f"{call.contract}.{_call_in_words(call.function, call.args)}" for call in calls)


def _call_in_words(function: str, args: Mapping[str, Any]) -> str:
    if function == "multicall" and "calls" in args:
        return "; ".join(_call_in_words(one["function"], one["args"]) for one in args["calls"])
    return f"{function or '?'}({', '.join(f'{name} {value}' for name, value in args.items())})"


def split_in_words(vote: BudgetVote, ballot: BudgetBallot) -> str:
    """Whom a member gave how many votes: alice 6, bob 8."""
    given = zip(vote.recipients, ballot.votes, strict=True)
    return ", ".join(f"{party(to.name, to.address)} {votes}" for to, votes in given if votes) or "nobody"


def voids_in_words(voids: Mapping[Fault, int]) -> str:
    """How many attempts ended void, by whose doing they were; empty where none did."""
    return ", ".join(f"{number:,} {FAULTS[fault]}" for fault, number in voids.items() if number)


def quorum_in_words(kind: KindRules) -> str:
    """How many of the committee's oracles judge a kind."""
    told = f"{kind.votes} of {len(kind.seats)} oracles that agree"
    if kind.panel < len(kind.seats):
        told += f", {kind.panel} of whom may vote at once"
        told += f" and one more after each {span(kind.rotation_s)}" if kind.rotation_s else ""
    return told


def windows_in_words(kind: KindRules) -> str:
    """10 min to 7 d to work, 3 min of them to give it back; empty where nobody has set them."""
    if not kind.max_window_s:
        return ""
    windows = f"{span(kind.min_window_s)} to {span(kind.max_window_s)} to work"
    return f"{windows}, the first {span(kind.grace_s)} to give it back"


def known_in_words(known: Known, moment: Callable[[float], str], now_s: float | None) -> str:
    """What the contracts know of a provider. What is over by `now_s` (site time) is left out, nothing where
    that is not known."""
    told = ["newcomer", "proven"][known.proven] + (" (vouched for)" if known.vouched else "")
    for what, until_s in (("rests", known.rests_until), ("bonds locked", known.bond_locked_until)):
        if until_s is not None and until_s > (now_s or 0.0):
            told += f"; {what} until {moment(until_s)}"
    return told


NAMERS: dict[str, str] = {
    "proven": "proven creators may name it",
    "nobody": "nobody may name it",
    "anybody": "anybody may name it",
}


def namers_in_words(service: Offer) -> str:
    """The creators whose tasks may name a service, in words; empty for the default."""
    told = "" if service.namers == "proven" else NAMERS[service.namers]
    if service.max_void_percent and service.namers != "nobody":
        told = f"{told or NAMERS['proven']}, unless over {service.max_void_percent} % of their tasks end void"
    return told


def tries_in_words(task: Task) -> str:
    """2 of 3; where some do not count: 5, of which 2 of at most 3 count."""
    if not task.passed:
        return f"{task.attempt} of {task.max_attempts}"
    return f"{task.attempt}, of which {task.attempts_counted} of at most {task.max_attempts} count"


def passed_in_words(task: Task) -> str:
    """The providers that a task is not offered again; empty where there are none."""
    names = [
        party(one.provider_name, one.provider) + (" (gave up)" if one.gave_up else "") for one in task.passed
    ]
    told = ", ".join(names)
    if len(names) >= PROVEN_FROM:
        told += "; while a proven provider offers such work, it is offered to proven ones only"
    return told


def span(seconds: float | None) -> str:
    """A length of time as people read it: 7 d, 2 h 5 min, 3 min 20 s, 12 s"""
    if seconds is None:
        return ""
    whole = max(0, round(seconds))
    parts = [(whole // 86400, "d"), (whole // 3600 % 24, "h"), (whole // 60 % 60, "min"), (whole % 60, "s")]
    first = next((place for place, (number, _) in enumerate(parts) if number), -1)
    return " ".join(f"{number} {unit}" for number, unit in parts[first:][:2] if number) or "0 s"
