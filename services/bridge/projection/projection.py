"""The table of all parts: which function takes in which event."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import Log, woken
from rodeo.money.currency import Currency
from services.bridge.projection import At, Table
from services.bridge.projection.governance import BudgetVotes, Proposals, Settings
from services.bridge.projection.judges import Judges
from services.bridge.projection.kinds import Kinds
from services.bridge.projection.providers import Line, ProviderEvents, Providers
from services.bridge.projection.services import Services
from services.bridge.projection.tasks import Tasks
from services.bridge.projection.tokens import Tokens
from services.bridge.rows import Rows

_BEGINNINGS = (
    events.TaskRegistered,
    events.Ruled,
    events.TaskRequeued,
    events.TaskFailed,
    events.ServiceRegistered,
    events.ServiceUpdated,
    events.ServiceAgreed,
    events.ProviderVouched,
)
"""With these the contracts begin something that may free a service or give it a task; a transaction of
another contract may make them do several things."""


class Projection:
    """Applies events to `rows`. `contracts`: name -> address."""

    def __init__(self, rows: Rows, contracts: Mapping[str, str], currency: Currency) -> None:
        providers, kinds = Providers(rows, contracts), Kinds(rows)
        self._line = Line(rows, providers)
        self._tokens = Tokens(rows, contracts, providers)
        parts = (
            kinds,
            self._tokens,
            ProviderEvents(providers, self._line),
            Services(rows, providers, self._line, kinds),
            Tasks(rows, providers, self._line, kinds, currency),
            Judges(rows, contracts, kinds, currency),
            Settings(rows, contracts, currency),
            Proposals(rows),
            BudgetVotes(rows),
        )
        self._table: Table = {event: function for part in parts for event, function in part.table().items()}
        self._ends: set[tuple[int, int]] = set()
        """(block, log index) of the last event of each thing that the contracts did."""
        self._woken: set[tuple[int, int]] = set()
        """(block, log index) of each event of a provider that has called `wakeUp`."""

    def prepare(self, logs: Iterable[Log]) -> None:
        """See all events that will be applied: a transfer is explained by its neighbours, before or after."""
        logs = list(logs)
        self._tokens.prepare(logs)
        self._woken = woken(logs)
        last: Log | None = None
        final: tuple[str, int | None] | None = None
        """Transaction and task of the last ruling, if it is final: how the attempt ends is part of it."""
        for log in logs:
            begins = isinstance(log.event, _BEGINNINGS) and final != _place(log)
            begins |= (log.block, log.log_index) in self._woken
            if last is not None and (last.tx_hash != log.tx_hash or begins):
                self._ends.add((last.block, last.log_index))
            if isinstance(log.event, events.Ruled):
                final = None if log.event.until else _place(log)
            last = log
        if last is not None:
            self._ends.add((last.block, last.log_index))

    def apply(self, seq: int, log: Log, time_s: int) -> None:
        """Apply the next of the events that `prepare` saw. Events that are not in the table change nothing
        that can be queried; they are kept and published."""
        place = log.block, log.log_index
        if (function := self._table.get(type(log.event))) is not None:
            function(log.event, At(seq, log, time_s, place in self._woken))
        if place in self._ends:
            self._line.place(time_s)


def _place(log: Log) -> tuple[str, int | None]:
    """Transaction and task of what happened."""
    return log.tx_hash, getattr(log.event, "task_id", None)
