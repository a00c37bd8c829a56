"""The recording of a session: the messages that its doors let in, its task's events, what was signed."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from rodeo.bus.messages import DaoEvent
from rodeo.evidence.recorder import OnSeal, Recorder, SealedProof
from rodeo.evidence.seal import QUIET_SEAL_PERIOD_NS, Binding
from rodeo.host.clock import Clock
from rodeo.recording.door import MessageDoor, Refusals
from rodeo.ros2.base import MessageInfo
from rodeo.signing.keys import Signer
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL
from services.charger.job import Recorded, recover


class Film:
    """A new recording, or the one that an earlier process left at `path`.

    Args:
        doors: topic -> what lets its messages in.
        meter_topic: the one of them whose messages the meter reads.
        on_seal: gets each seal, from the recording's thread.

    Raises RecordingSealed when it is finished.
    """

    def __init__(
        self,
        path: Path,
        binding: Binding,
        account: Signer,
        clock: Clock,
        doors: Mapping[str, MessageDoor],
        meter_topic: str,
        on_seal: OnSeal | None,
    ) -> None:
        self.resumed = path.exists()
        self.before = recover(path, "/" + meter_topic) if self.resumed else Recorded()
        """What the earlier process recorded."""
        self.seals = self.before.seals
        """Digests of those of the recording."""
        self.meter_topic = meter_topic
        self.refusals = Refusals()
        self._clock, self._doors, self._tell_seal = clock, doors, on_seal
        self._events_seq = self.before.events_seq
        begin = Recorder.resume if self.resumed else Recorder
        self._recorder = begin(path, binding, account, clock, self._on_seal, QUIET_SEAL_PERIOD_NS)

    @property
    def recording(self) -> str:
        """0x digest of the opening seal."""
        return self._recorder.recording

    def let_in(self, topic: str, typename: str, info: MessageInfo) -> bool:
        """Record a message, unless it is nonsense."""
        now_ns = self._clock.now_ns()
        refusal = self._doors[topic].refusal(info, now_ns)
        if refusal is not None:
            self.refusals.count("message", refusal)
            return False
        self._recorder.write_ros(topic, typename, info.cdr, now_ns, info.source_time_ns, info.sequence)
        return True

    def event(self, event: DaoEvent) -> None:
        """Record a contract event, once."""
        if event.seq > self._events_seq:
            self._events_seq = event.seq
            self.note(event.model_dump(mode="json"))

    def attest(self, attestation: dict[str, Any]) -> None:
        self._recorder.write_json(ATTESTATION_CHANNEL, attestation)

    def note(self, payload: dict[str, Any]) -> None:
        self._recorder.write_json(EVENT_CHANNEL, payload)

    def close(self) -> SealedProof:
        return self._recorder.close()

    def suspend(self) -> None:
        """Leave it so that the next process can continue with it."""
        self._recorder.suspend()

    def _on_seal(self, data: bytes) -> None:
        """From the recording's thread."""
        self.seals.add("0x" + sha256(data).hexdigest())
        if self._tell_seal is not None:
            self._tell_seal(data)
