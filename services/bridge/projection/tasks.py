"""Tasks, their attempts and the rulings on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from rodeo.bus.session import decode_json
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import Cause
from rodeo.chain.reputation import Work
from rodeo.errors import MalformedJson
from rodeo.money.currency import Currency
from rodeo.text.strict_json import whole_characters
from services.bridge import schema
from services.bridge.projection import At, Table, hex_of
from services.bridge.projection.kinds import Kinds
from services.bridge.projection.providers import AWAKE, Line, Providers
from services.bridge.rows import Rows


class Tasks:
    """Events about one task."""

    def __init__(
        self, rows: Rows, providers: Providers, line: Line, kinds: Kinds, currency: Currency
    ) -> None:
        self._rows, self._providers, self._line, self._kinds = rows, providers, line, kinds
        self._currency = currency
        self._reported: tuple[str, events.Reported] | None = None
        """The transaction of the last report, and its contents for the ruling that follows."""

    def table(self) -> Table:
        change = self._change
        return {
            events.TaskRegistered: self._registered,
            events.ServiceRequested: lambda one, _: change(one.task_id, requested_service_id=one.service_id),
            events.ProviderRequested: lambda one, _: change(one.task_id, requested_provider=one.provider),
            events.TaskAssigned: self._assigned,
            events.TaskAccepted: lambda one, _: change(one.task_id, accepted=True),
            events.ProofSubmitted: self._proof_submitted,
            events.Reported: self._remember_report,
            events.PassedOn: lambda one, _: change(one.task_id, passed_on=True),
            events.Ruled: self._ruled,
            events.TaskSettled: self._settled,
            events.TaskPassed: self._passed,
            events.TaskRequeued: self._requeued,
            events.TaskFailed: self._failed,
            events.TaskCancelled: lambda one, at: change(
                one.task_id, state="cancelled", ended=at.time_s, refunded=one.refund
            ),
        }

    def _get(self, task_id: int) -> Mapping[str, Any]:
        return self._rows.get(schema.tasks, task_id)

    def _change(self, task_id: int, **values: Any) -> None:
        self._rows.change(schema.tasks, task_id, **values)

    def _registered(self, event: events.TaskRegistered, at: At) -> None:
        params, description = parse_task_text(event.params)
        kind = self._kinds.get(event.kind)
        self._rows.add(
            schema.tasks,
            id=event.task_id,
            kind=event.kind,
            state="open",
            attempt=0,
            max_attempts=event.max_attempts,
            creator=event.creator,
            reward=event.reward,
            paid=0,
            refunded=0,
            execution_window_s=event.execution_window,
            verdict_window_s=event.verdict_window,
            grace_s=kind["grace_s"],
            passed=[],
            audit_window_s=kind["audit_window_s"],
            number=kind["number"],
            after_removal=False,
            passed_on=False,
            set_aside=0,
            rules_sha256=hex_of(event.rules) if any(event.rules) else None,
            params=params,
            description=description,
            registered=at.time_s,
            opened=at.time_s,
        )
        self._rows.add(schema.texts, task_id=event.task_id, text=event.params.lower())

    def _assigned(self, event: events.TaskAssigned, at: At) -> None:
        self._change(
            event.task_id,
            **dict.fromkeys(_OF_ATTEMPT),
            after_removal=False,
            passed_on=False,
            state="assigned",
            accepted=self._rows.get(schema.services, event.service_id)["auto_accept"],
            attempt=event.attempt,
            executor=event.executor,
            service_id=event.service_id,
            price=event.price,
            assigned=at.time_s,
            execution_deadline=event.deadline,
            nonce=hex_of(event.nonce),
        )
        self._rows.change(schema.services, event.service_id, task_id=event.task_id, place=0)
        self._line.take(event.service_id)  # its next task, before it waited

    def _proof_submitted(self, event: events.ProofSubmitted, at: At) -> None:
        task = self._get(event.task_id)
        deadline = at.time_s + task["verdict_window_s"]
        self._change(
            event.task_id,
            state="submitted",
            proof_submitted=at.time_s,
            proof_sha256=hex_of(event.proof_hash),
            proof_uri=event.uri,
            verdict_deadline=deadline,
            case_end=deadline + task["audit_window_s"],
        )

    def _passed(self, event: events.TaskPassed, at: At) -> None:
        provider = self._rows.get(schema.services, event.provider)["provider"]
        passed = [*self._get(event.task_id)["passed"], {"provider": provider, "gave_up": event.gave_up}]
        self._change(event.task_id, passed=passed)

    # -- rulings -------------------------------------------------------------------------------------------

    def _remember_report(self, event: events.Reported, at: At) -> None:
        self._reported = at.log.tx_hash, event

    def _ruled(self, event: events.Ruled, at: At) -> None:
        """Store a judge's ruling on a proof; or that nobody ruled, or that the one who did is no judge any
        more."""
        task = self._get(event.task_id)
        standing = {
            "ruling": event.ruling.name.lower(),
            "fault": event.fault.name.lower(),
            "amount_iec": self._currency.text(event.amount),
            "until": event.until,
        }
        if task["state"] == "submitted":
            self._free_service(task)
        # A final ruling is applied at once, by the events that follow.
        self._change(
            event.task_id,
            **self._report_of(event, at.log.tx_hash, task),
            state="ruled",
            standing=standing,
            standing_until=event.until or None,
            after_removal=bool(self._kinds.number(task["number"])["removed"]),
        )

    def _report_of(self, event: events.Ruled, tx_hash: str, task: Mapping[str, Any]) -> dict[str, Any]:
        """The judge's words, if any: in the same transaction, or an earlier one where the same ruling stands
        longer now."""
        sha256 = hex_of(event.report) if any(event.report) else None
        where, said = self._reported or ("", None)
        self._reported = None  # it comes right before its ruling
        if said is not None and (where, said.task_id) == (tx_hash, event.task_id):
            return {"reason": said.reason, "report_sha256": sha256, "report_uri": said.report_uri}
        if sha256 is not None and sha256 == task["report_sha256"]:
            return {}
        return {"reason": None, "report_sha256": sha256, "report_uri": None}

    # -- ends ----------------------------------------------------------------------------------------------

    def _settled(self, event: events.TaskSettled, at: At) -> None:
        standing = self._get(event.task_id)["standing"]
        # An impossible task does not count as completed.
        counter = "completed" if standing["ruling"] == "accepted" else None
        self._end_attempt(event.task_id, counter, event.paid, at.time_s)
        self._change(
            event.task_id,
            **_WITHOUT_RULING,
            verdict=standing["ruling"],
            state="settled",
            settled=at.time_s,
            ended=at.time_s,
            paid=event.paid,
            refunded=event.refund,
        )

    def _requeued(self, event: events.TaskRequeued, at: At) -> None:
        verdict = self._fail_attempt(event.task_id, event.cause, at.time_s)
        self._change(
            event.task_id,
            **_WITHOUT_RULING,
            **dict.fromkeys(_OF_ASSIGNMENT),
            **verdict,
            state="open",
            opened=at.time_s,
        )

    def _failed(self, event: events.TaskFailed, at: At) -> None:
        verdict = self._fail_attempt(event.task_id, event.cause, at.time_s)
        ended = {"state": "failed", "ended": at.time_s, "refunded": event.refund}
        self._change(event.task_id, **_WITHOUT_RULING, **verdict, **ended)

    def _free_service(self, task: Mapping[str, Any]) -> None:
        """End the attempt for its service, if not yet for its record."""
        self._rows.change(schema.services, task["service_id"], task_id=None)
        self._line.free(task["service_id"])

    def _fail_attempt(self, task_id: int, cause: Cause, time_s: int) -> dict[str, Any]:
        """Returns how the attempt ended."""
        task = self._get(task_id)
        self._end_attempt(task_id, _COUNTER.get(cause), task["price"], time_s)
        if cause not in _OF_RULING:
            return dict(_VERDICT_OF_EXPIRY[cause])
        is_void = cause is Cause.VOID
        return {"verdict": cause.name.lower(), "fault": task["standing"]["fault"] if is_void else None}

    def _end_attempt(self, task_id: int, counter: str | None, value: int, time_s: float) -> None:
        """End an attempt that was paid, or would have been, `value` wei; its service's `counter` goes up by
        one."""
        task = self._get(task_id)
        if task["state"] != "ruled":  # else it was free since the first ruling
            self._free_service(task)
        if counter is None:
            return
        service = self._rows.get(schema.services, task["service_id"])
        # As ServiceManager counts: consecutive failures of all the provider's services.
        provider = self._providers.get(service["provider"])
        completed, failures = counter == "completed", min(provider["failures"] + 1, 255)
        work = Work(provider["done"], provider["failed"], provider["day"], provider["creator"])
        own = self._providers.is_own(task["creator"], service["provider"])
        if not own:
            counted = min(value, self._kinds.get(task["kind"])["reference_price"])
            creator = "" if self._providers.is_organization(task["creator"]) else task["creator"]
            work = work.plus(counted, completed, time_s, creator, self._currency)
        if completed:
            failures = provider["failures"] if own else 0
        forgiven = AWAKE if completed and not own else {}
        self._providers.change(service["provider"], failures=failures, **forgiven, **asdict(work))
        self._rows.change(schema.services, service["id"], **{counter: service[counter] + 1})


_OF_ATTEMPT = (
    "proof_submitted",
    "verdict_deadline",
    "case_end",
    "proof_sha256",
    "proof_uri",
    "verdict",
    "fault",
    "reason",
    "report_sha256",
    "report_uri",
    "dispute",
)
"""Columns that a new attempt starts without. Until then they show how the last attempt ended."""

_OF_ASSIGNMENT = (
    "executor",
    "service_id",
    "price",
    "accepted",
    "assigned",
    "execution_deadline",
    "verdict_deadline",
    "case_end",
    "nonce",
)
"""Columns that only an assigned task has."""

_WITHOUT_RULING: dict[str, Any] = {"standing": None, "standing_until": None, "set_aside": 0}
"""Columns of a task on which no ruling stands."""

_OF_RULING = (Cause.REJECTED, Cause.GIVEN_UP, Cause.VOID)
"""Causes that a judge decides; the others are the executor's own."""

_COUNTER = {
    Cause.REJECTED: "rejected",
    Cause.EXECUTION_EXPIRED: "expired",
    Cause.ABANDONED_LATE: "expired",
}
"""What a failed attempt adds to its service's record. Void, given-up and unaccepted attempts add nothing."""

_VERDICT_OF_EXPIRY = {
    Cause.EXECUTION_EXPIRED: {"verdict": "expired", "reason": "no proof within the execution window"},
    Cause.NOT_ACCEPTED: {"verdict": "expired", "reason": "the executor did not accept the task in time"},
    Cause.ABANDONED: {
        "verdict": "abandoned",
        "reason": "the executor gave the task back in the grace period, or had not accepted it",
    },
    Cause.ABANDONED_LATE: {
        "verdict": "abandoned",
        "reason": "the executor gave the task back after the grace period",
    },
}


def parse_task_text(text: str) -> tuple[dict[str, Any], str]:
    """Parameters and description from a task's `params`, which anybody may have filled with anything."""
    try:
        value = decode_json(whole_characters(text).encode(errors="replace"))
    except MalformedJson:
        return {}, text
    params, description = value.get("params"), value.get("description", "")
    if not isinstance(params, dict) or not isinstance(description, str):
        return {}, text
    return params, description
