"""The one chain of statements that a device signs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Literal

from rodeo.evidence.attestation import Attestation, attest
from rodeo.signing.keys import Signer
from rodeo.witness import ocmf
from rodeo.witness.days import Days
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Header, MeterRecord, Scope

Inputs = Literal["sensor", "closed_bus", "open_bus"]


class WitnessChain:
    """Signs statements for `device`, each naming the one before and the heads heard since. Thread-safe.

    A `MeterRecord` gets its OCMF text here, where its number and its heads are known.

    >>> chain.sign(Removal, now_s, compartment="blue", weight_n=0.4, after_s=t, settled_s=t + 1)
    """

    def __init__(
        self,
        device: str,
        account: Signer,
        scope: Scope,
        inputs: Inputs,
        journal: Journal,
        heads: HeadBook,
        days: Days | None = None,
    ) -> None:
        self.device = device
        self.heads = heads
        self._account = account
        self._scope = scope
        self._inputs = inputs
        self._journal = journal
        self._days = days
        self._lock = threading.RLock()

    @property
    def address(self) -> str:
        return self._account.address

    @property
    def scope(self) -> Scope:
        """For which organization it signs."""
        return self._scope

    def sign_for(self, scope: Scope) -> None:
        """From now on: the organization is on another chain."""
        with self._lock:
            self._scope = scope

    def sign(self, model: type[Header], time_s: float, **fields: Any) -> Attestation:
        """The next statement, journaled and not yet published. Raises BrokenJournal, ValidationError."""
        return self.sign_next(model, time_s, lambda _seq: fields)

    def sign_next(
        self, model: type[Header], time_s: float, fields: Callable[[int], dict[str, Any]]
    ) -> Attestation:
        """The same with fields that depend on the statement's `seq`."""
        with self._lock:
            seq = self._journal.seq + 1
            said: dict[str, Any] = {
                **self._scope.model_dump(),
                "device": self.device,
                "seq": seq,
                "previous": self._journal.previous,
                "time_s": time_s,
                "heads": self.heads.take(),
                "inputs": self._inputs,
                **fields(seq),
            }
            if model is MeterRecord and "ocmf" not in said:
                text = ocmf.data(MeterRecord(**said, ocmf=""))
                said["ocmf"] = ocmf.sign(text, bytes(self._account.key))
            statement = model(**said)
            attestation = attest(statement.model_dump(mode="json"), self._account)
            self._journal.add(attestation)
            if self._days is not None:
                self._days.add(attestation)
            return attestation

    def after(self, seq: int, limit: int) -> list[Attestation]:
        """What was signed after number `seq`, as it was signed then; the oldest first."""
        with self._lock:
            return self._journal.after(seq, limit)

    def last(self, limit: int) -> list[Attestation]:
        """The last `limit` statements, the oldest first."""
        with self._lock:
            return self._journal.after(self._journal.seq - limit, limit)
