"""Heads of the recording as witnesses list them: each is in the file, or there is another version of it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

import numpy as np

from rodeo.checks.case import Case
from rodeo.checks.report import Finding, equal
from rodeo.checks.signed.statements import Said
from rodeo.checks.tables import events_of
from rodeo.evidence.tally import RESUMED
from rodeo.site.topics import EVENT_CHANNEL, SEAL_CHANNEL
from rodeo.witness.statement import Head

LISTED_S = 3.0
"""From when something was measured until motion capture lists a head that covers it: a seal and a statement
come once a second each, and one of either may be lost."""
RESUMED_S = 1.0
"""Recorded before a power cut and lost by it: what follows the last seal on disk."""
MOST_CUTS = 3
"""Most cuts of which witnesses may have heard what was lost: whoever notes a cut every few seconds would
otherwise be free to write another version."""


def listed(case: Case, said: Sequence[Said]) -> Iterator[tuple[Said, Head]]:
    """The heads of this very recording that a witness lists, in the file or not."""
    own = (case.proof.signer or "").lower()
    for one in said:
        for head in one.statement.heads:
            if head.address.lower() == own and head.chain is not None and head.chain == case.proof.recording:
                yield one, head


def in_file(case: Case, head: Head) -> bool:
    digests = case.proof.seal_digests
    return head.index < len(digests) and digests[head.index] == head.digest


def fork(case: Case, *witnesses: Sequence[Said]) -> Finding | None:
    """A head that a witness lists and the file lacks, as a finding: there is another version of the file.
    The same device's second recording that grew while this one did is one, too: whoever makes two submits
    the better one.

    Where the recorder notes that it went on after a cut, the last second before may be lost. A witness that
    says little lists a lost head in the first statement that it makes after the cut, however late that is.
    """
    kept, kept_s = _cuts(case)
    forgiven: set[int] = set()
    for said in witnesses:
        times_s = sorted(one.statement.time_s for one in said)
        for one, head in listed(case, said):
            if in_file(case, head):
                continue
            time_s = one.statement.time_s
            # The last cut before which this seal may have been made, and the statement heard of it.
            cut = min(bisect_right(kept, head.index), bisect_right(kept_s, time_s + case.slack_s)) - 1
            soon = cut >= 0 and time_s <= kept_s[cut] + (RESUMED_S + LISTED_S) * case.speed
            first = cut >= 0 and bisect_left(times_s, kept_s[cut]) == bisect_left(times_s, time_s)
            if soon or first:
                forgiven.add(cut)
            if not (soon or first) or len(forgiven) > MOST_CUTS:
                return equal(
                    f"seal {head.index} {head.digest[:18]}",
                    None,
                    source=f"heads that {one.statement.device} lists",
                    detail="a seal of this recording that is not in the file",
                )
        if (twin := _twin(case, said)) is not None:
            return twin
    return None


def _twin(case: Case, said: Sequence[Said]) -> Finding | None:
    """Another recording of this device that grew beside this one, as a finding.

    The last head of the recording before may be listed once after this one began.
    """
    own = (case.proof.signer or "").lower()
    began = False
    others: dict[str | None, int] = {}
    for one in said:
        heads = {head.chain: head.index for head in one.statement.heads if head.address.lower() == own}
        began = began or case.proof.recording in heads
        for chain in heads.keys() - {case.proof.recording, None} if began else ():
            if others.setdefault(chain, heads[chain]) != heads[chain]:
                return equal(
                    f"seal {heads[chain]} of {(chain or '')[:18]}",
                    None,
                    source=f"heads that {one.statement.device} lists",
                    detail="another recording of the same device grew at the same time",
                )
    return None


def _cuts(case: Case) -> tuple[list[int], list[float]]:
    """For each time that the recorder notes that it went on after a cut: how many seals it kept, and the log
    time of the last of them (s)."""
    if EVENT_CHANNEL not in case.proof.topics:
        return [], []
    seals_ns = np.frombuffer(case.proof.topics[SEAL_CHANNEL].log_ns, np.uint64)
    noted = zip(events_of(case), case.proof.topics[EVENT_CHANNEL].log_ns, strict=True)
    resumed_ns = sorted(log_ns for event, log_ns in noted if event.get("event") == RESUMED)
    kept, kept_s = [], []
    for log_ns in resumed_ns:
        count = int(np.searchsorted(seals_ns, log_ns))
        kept.append(count)
        kept_s.append(int(seals_ns[count - 1] if count else log_ns) * 1e-9)
    return kept, kept_s
