"""The book of a session: the records that the meter signed, and the robot's receipts for them."""

from __future__ import annotations

import math

from rodeo.evidence.attestation import Attestation
from rodeo.witness.statement import MeterRecord, Receipt, digest, parse
from services.charger.film import Film


class Book:
    """The book of the session that `film` records; `meter` is the address that signs the records."""

    def __init__(self, meter: str, film: Film) -> None:
        self._meter, self._film = meter, film
        self._records: dict[str, MeterRecord] = {}
        """Digest -> each record of this session."""
        self._receipts: dict[int, str] = {}
        """Number -> digest of each receipt that is on record."""
        self.last: Attestation | None = None
        """The last record."""
        self.said_s = -math.inf
        """When the last record was published."""
        self.listed = False
        """The robot listed this recording: its receipts count."""
        self.signed_wh: float | None = None
        """The highest register that the robot signed."""
        self.closed = False
        """The robot signed the end of the session."""

    def add(self, signed: Attestation) -> MeterRecord:
        """Enter a record of the meter."""
        record = parse(signed.payload)
        assert isinstance(record, MeterRecord)  # the meter signs nothing else
        self._records[digest(signed)] = record
        self.last = signed
        return record

    @property
    def unanswered(self) -> Attestation | None:
        """The last record, while the robot did not sign for as much."""
        last = self.last
        if last is None or self.closed:
            return None
        signed = self.signed_wh is not None and self.signed_wh >= float(last.payload["register_wh"])
        return None if signed and last.payload["reason"] != "close" else last

    @property
    def answered(self) -> bool:
        return self.last is not None and self.unanswered is None

    def wrong_with(self, receipt: Receipt, own: str) -> str | None:
        """Why a receipt must not be recorded: the buyer must not be able to spoil the seller's proof with it.
        `own` is its digest."""
        record = self._records.get(receipt.record)
        if record is None or not receipt.repeats(record, self._meter):
            return f"the meter has no such record: {receipt.record}"
        lacking = [one for one in self._listed_seals(receipt) if one not in self._film.seals]
        if lacking and not self._film.resumed:
            return f"it lists a seal that is not in the recording: {lacking[0]}"
        if self._receipts.setdefault(receipt.seq, own) != own:
            return f"the robot signed another receipt with number {receipt.seq}"
        return None

    def count(self, receipt: Receipt, own: str) -> None:
        """Enter a receipt that is on record."""
        self._receipts[receipt.seq] = own
        self.listed = self.listed or not self._film.seals.isdisjoint(self._listed_seals(receipt))
        self.signed_wh = max(self.signed_wh or 0.0, receipt.register_wh)
        self.closed = self.closed or receipt.reason == "close"

    def _listed_seals(self, receipt: Receipt) -> list[str]:
        return [head.digest for head in receipt.heads if head.chain == self._film.recording]
