"""Records one task into one sealed MCAP file.

Subscribers only append to a list; a thread of its own writes, hashes, seals and flushes, so a slow disk
never blocks the bus. It takes up a tenth of a second of recorded time at once: to wake it for each message
costs more than to write one. Every seal closes a chunk, so a killed process loses at most what came after
the last one (`SEAL_PERIOD_NS` of recorded time by default).
"""

from __future__ import annotations

import logging
import os
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path
from typing import Any, NamedTuple

from rodeo.evidence.container import Limits
from rodeo.evidence.errors import (
    BrokenSeal,
    ContainerError,
    RecorderFailed,
    RecordingExists,
    RecordingSealed,
)
from rodeo.evidence.reader import SealedReader
from rodeo.evidence.seal import SEAL_PERIOD_NS, Binding, RunningHash, SealAudit, SealChain, channel_digest
from rodeo.evidence.tally import CLOSED, RESUMED, Tally
from rodeo.evidence.writer import McapWriter
from rodeo.host.clock import TimeSource
from rodeo.ros2.definitions import schema_text
from rodeo.signing.keys import Signer
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, SEAL_CHANNEL
from rodeo.text.strict_json import plain, write_json

log = logging.getLogger(__name__)

UNREADABLE = "unreadable"
"""Event in place of an event or statement that readers refuse: {"event", "channel", "name", "why"}."""
_JSON_CHANNELS = frozenset({EVENT_CHANNEL, ATTESTATION_CHANNEL})
_MOST_JSON_BYTES = Limits().json_bytes
_IDLE_SEAL_S = 1.0
"""Wall time after which messages are sealed although no further one came."""
_AT_ONCE_NS = 100_000_000
"""Recorded time whose messages are written together."""

OnSeal = Callable[[bytes], None]
"""Gets a seal message's bytes."""

_LENGTH_FIELD, _TAIL = slice(1, 9), slice(11, None)
"""Parts of an MCAP message record: its length, and what follows the channel's number."""


@dataclass(frozen=True)
class SealedProof:
    """A finished recording: `sha256` (0x, 32 bytes) of the file is what goes on chain."""

    path: Path
    sha256: str
    messages: int


class _Entry(NamedTuple):
    topic: str
    schema_name: str
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes
    urgent: bool = False
    """To be signed and on disk at once."""


class Recorder:
    """Appends messages from any thread; `close()` seals the file for good, `suspend()` leaves it resumable.

    As a context manager it suspends on exit unless it was closed.
    """

    def __init__(
        self,
        path: Path,
        binding: Binding,
        account: Signer,
        clock: TimeSource,
        on_seal: OnSeal | None = None,
        seal_period_ns: int | None = None,
    ) -> None:
        """Start a new recording. Raises RecordingExists rather than overwrite.

        `on_seal` gets each seal but the final one as it is in the file, from the writing
        thread, once it is there. A seal leaves `seal_period_ns` (default `SEAL_PERIOD_NS`) unsigned at most.
        """
        if path.exists():
            raise RecordingExists("a recording exists already; resume it", path=str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._begin(path, path, binding, account, clock, on_seal, seal_period_ns, restored=[])

    @classmethod
    def resume(
        cls,
        path: Path,
        binding: Binding,
        account: Signer,
        clock: TimeSource,
        on_seal: OnSeal | None = None,
        seal_period_ns: int | None = None,
    ) -> Recorder:
        """Continue a recording that was cut off, keeping every message up to its last valid chunk.

        The cut is recorded as an event {"event": "recording_resumed", "kept_messages", "last_log_ns"}.
        Raises RecordingSealed when it is finished, BrokenSeal when it belongs to another assignment or was
        changed, OSError when it cannot be read.
        """
        recorder, restored = cls._reopen(path, binding, account, clock, on_seal, seal_period_ns)
        recorder.write_json(
            EVENT_CHANNEL,
            {
                "event": RESUMED,
                "kept_messages": len(restored),
                "last_log_ns": str(restored[-1].log_ns) if restored else None,
            },
        )
        return recorder

    @classmethod
    def finish(cls, path: Path, binding: Binding, account: Signer, clock: TimeSource) -> SealedProof:
        """Seal a suspended or cut off recording as it is. Raises like `resume`."""
        recorder, _ = cls._reopen(path, binding, account, clock, None, None)
        return recorder.close()

    @classmethod
    def _reopen(
        cls,
        path: Path,
        binding: Binding,
        account: Signer,
        clock: TimeSource,
        on_seal: OnSeal | None,
        seal_period_ns: int | None,
    ) -> tuple[Recorder, list[_Entry]]:
        restored = _restore(path, binding, account)
        recorder = cls.__new__(cls)
        path.parent.mkdir(parents=True, exist_ok=True)
        # The old file stays in place until all of it is in the new one: being killed here loses nothing.
        part = path.with_suffix(".resuming")
        recorder._begin(part, path, binding, account, clock, on_seal, seal_period_ns, restored)
        return recorder, restored

    def _begin(
        self,
        write_path: Path,
        path: Path,
        binding: Binding,
        account: Signer,
        clock: TimeSource,
        on_seal: OnSeal | None,
        seal_period_ns: int | None,
        restored: list[_Entry],
    ) -> None:
        self.path = path
        self._clock = clock
        self._lock = threading.Lock()
        self._waiting: list[_Entry] = []
        self._due = False
        """Whether what waits is to be written now."""
        self._changed = threading.Condition(self._lock)
        self._accepting = True
        self._finished = False
        self._failure: Exception | None = None
        self._sequences: dict[str, int] = {}
        self._file = _SealedFile(write_path, SealChain(binding, account), on_seal, seal_period_ns)
        if restored:
            self._file.restore(restored)
        else:
            self._file.open_chain(clock.now_ns())
        os.replace(write_path, path)
        self._thread = threading.Thread(target=self._write_all, name=f"recorder {path.name}", daemon=True)
        self._thread.start()

    @property
    def recording(self) -> str:
        """0x SHA-256 of the opening seal: what others call this recording."""
        return self._file.recording

    def write_ros(
        self, topic: str, ros_type: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """One ROS 2 message exactly as it came: `cdr` with its encapsulation header.

        `topic` becomes absolute (`/panther1/odom`), as ROS 2 bags name it; `sequence` is the publisher's.
        Raises RecorderFailed when the disk failed, RecordingSealed after `close()` or `suspend()`.
        """
        name = topic if topic.startswith("/") else "/" + topic
        self._put(_Entry(name, ros_type, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns, cdr))

    def write_json(self, channel: str, payload: dict[str, Any], *, urgent: bool = True) -> None:
        """One JSON object on `rodeo/event` or `rodeo/attestation`, stamped with the clock's time.

        What is `urgent` is signed and on disk at once: being killed right after it must not lose it.

        A payload that readers refuse (`rodeo.text.strict_json`) is left out, and an event `UNREADABLE` says
        so: others wrote it, and the whole file would be refused for it.
        """
        if channel not in _JSON_CHANNELS:
            raise ValueError(f"no such JSON channel: {channel}")
        try:
            data = write_json(payload)
            if len(data) > _MOST_JSON_BYTES:
                raise ValueError(f"{len(data)} bytes are more than {_MOST_JSON_BYTES}")
        except ValueError as error:
            log.warning("left out of the recording what nobody could read: %s", error)
            left_out = {
                "event": UNREADABLE,
                "channel": channel,
                "name": payload.get("name"),
                "why": str(error),
            }
            channel, data = EVENT_CHANNEL, write_json(plain(left_out))
        now_ns = self._clock.now_ns()
        with self._lock:
            sequence = self._sequences[channel] = self._sequences.get(channel, -1) + 1
        self._put(_Entry(channel, "", sequence, now_ns, now_ns, data, urgent))

    def stop(self) -> None:
        """Accept nothing more; everything so far is signed and on disk, and `close` or `suspend` can follow.

        Raises RecorderFailed.
        """
        with self._lock:
            self._require_accepting()
            self._accepting = False
            self._write_now()
        self._thread.join()
        self._guarded(self._file.sync)

    def close(self) -> SealedProof:
        """Write everything, the final seal and the file's index. Raises RecorderFailed."""
        self._finish(final=True)
        with self.path.open("rb") as file:
            sha256 = "0x" + file_digest(file, "sha256").hexdigest()
        return SealedProof(self.path, sha256, self._file.running.messages)

    def suspend(self) -> None:
        """Write and seal everything so far and let go of the file, for a later `resume`."""
        self._finish(final=False)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._finished:
            self.suspend()

    def _put(self, entry: _Entry) -> None:
        with self._lock:
            if self._failure is not None:
                raise self._failed() from self._failure
            self._require_accepting()
            self._waiting.append(entry)
            if entry.urgent or entry.log_ns - self._waiting[0].log_ns >= _AT_ONCE_NS:
                self._write_now()

    def _write_now(self) -> None:
        self._due = True
        self._changed.notify()

    def _require_accepting(self) -> None:
        if not self._accepting:
            raise RecordingSealed("the recording is finished", path=str(self.path))

    def _finish(self, *, final: bool) -> None:
        if self._finished:
            raise RecordingSealed("the recording is finished", path=str(self.path))
        self._finished = True
        if self._accepting:
            self.stop()
        self._guarded(lambda: self._file.finish(final=final))

    def _guarded(self, write: Callable[[], None]) -> None:
        if self._failure is None:
            try:
                write()
            except Exception as error:  # noqa: BLE001 - whatever it is, the caller hears of it
                self._failure = error
        if self._failure is not None:
            raise self._failed() from self._failure

    def _failed(self) -> RecorderFailed:
        return RecorderFailed("the recording cannot be written", path=str(self.path))

    def _write_all(self) -> None:
        try:
            accepting = True
            while accepting:
                with self._changed:
                    idle = not self._changed.wait_for(lambda: self._due, _IDLE_SEAL_S)
                    entries, self._waiting, self._due = self._waiting, [], False
                    accepting = self._accepting
                for entry in entries:
                    self._file.add(entry)
                if idle and not entries:
                    self._file.seal()
        except Exception as error:  # noqa: BLE001 - whatever it is, the next caller has to hear of it
            with self._lock:
                self._failure = error


class _SealedFile:
    """The MCAP file behind a recorder; one thread at a time."""

    def __init__(
        self,
        path: Path,
        chain: SealChain,
        on_seal: OnSeal | None,
        seal_period_ns: int | None = None,
    ) -> None:
        self.running = RunningHash()
        self._seal_period_ns = SEAL_PERIOD_NS if seal_period_ns is None else seal_period_ns
        self._chain = chain
        self._on_seal = on_seal
        self._stream = path.open("wb")
        self._writer = McapWriter(self._stream, profile="ros2", library="rodeo")
        self._schemas: dict[str, tuple[int, bytes]] = {}
        self._channels: dict[str, tuple[int, bytes]] = {}
        self._tallies: dict[str, Tally] = defaultdict(Tally)
        self._last_log_ns = 0
        self._unsealed_since_ns: int | None = None

    @property
    def recording(self) -> str:
        assert self._chain.recording is not None, "every file begins with the opening seal"
        return "0x" + self._chain.recording

    def open_chain(self, now_ns: int) -> None:
        """The opening seal."""
        self._last_log_ns = now_ns
        self._write_seal()

    def restore(self, entries: list[_Entry]) -> None:
        """Take over the messages of an earlier file, their seals included."""
        for entry in entries:
            self._write(entry)
            if entry.topic == SEAL_CHANNEL:
                self._chain.adopt(entry.data)
                self._unsealed_since_ns = None
        self._flush()

    def add(self, entry: _Entry) -> None:
        since_ns = self._unsealed_since_ns
        if since_ns is not None and entry.log_ns - since_ns >= self._seal_period_ns:
            self.seal()
        self._write(entry)
        if entry.urgent:
            self.seal()

    def seal(self) -> None:
        """Sign what is not yet signed and put it on disk."""
        if self._unsealed_since_ns is not None:
            self._write_seal()

    def sync(self) -> None:
        """Sign what is not yet signed; returns when the disk has all of it."""
        self.seal()
        os.fsync(self._stream.fileno())

    def finish(self, *, final: bool) -> None:
        self.seal()
        if final:
            self._write_tallies()
            data = self._chain.final(self.running)
            self._write(
                _Entry(SEAL_CHANNEL, "", self.running.messages, self._last_log_ns, self._last_log_ns, data)
            )
        self._writer.finish()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def _write_tallies(self) -> None:
        topics = {topic: tally.counts() for topic, tally in self._tallies.items()}
        data = write_json({"event": CLOSED, "topics": topics})
        self._write(
            _Entry(EVENT_CHANNEL, "", self.running.messages, self._last_log_ns, self._last_log_ns, data)
        )

    def _write_seal(self) -> None:
        data = self._chain.next(self.running, self._last_log_ns)
        self._write(
            _Entry(SEAL_CHANNEL, "", self.running.messages, self._last_log_ns, self._last_log_ns, data)
        )
        self._unsealed_since_ns = None
        self._flush()
        if self._on_seal is not None:
            self._on_seal(data)

    def _flush(self) -> None:
        self._writer.flush()

    def _write(self, entry: _Entry) -> None:
        channel_id, digest = self._channels.get(entry.topic) or self._register(entry.topic, entry.schema_name)
        record = memoryview(
            self._writer.add_message(channel_id, entry.sequence, entry.log_ns, entry.publish_ns, entry.data)
        )
        self.running.add(digest, record[_LENGTH_FIELD], record[_TAIL])
        if entry.schema_name:
            self._tallies[entry.topic].add(entry.sequence)
        self._last_log_ns = max(self._last_log_ns, entry.log_ns)
        if self._unsealed_since_ns is None:
            self._unsealed_since_ns = entry.log_ns

    def _register(self, topic: str, schema_name: str) -> tuple[int, bytes]:
        if schema_name:
            schema_id, text = self._schemas.get(schema_name) or self._register_schema(schema_name)
            channel_id = self._writer.register_channel(topic, "cdr", schema_id)
            digest = channel_digest(topic, "cdr", schema_name, "ros2msg", text)
        else:
            # Schemaless: the rosbags reader refuses files with a jsonschema, and JSON needs none.
            channel_id = self._writer.register_channel(topic, "json", 0)
            digest = channel_digest(topic, "json", "", "", b"")
        self._channels[topic] = channel_id, digest
        return channel_id, digest

    def _register_schema(self, name: str) -> tuple[int, bytes]:
        text = schema_text(name).encode()
        schema = self._writer.register_schema(name, "ros2msg", text), text
        self._schemas[name] = schema
        return schema


def _restore(path: Path, binding: Binding, account: Signer) -> list[_Entry]:
    """The messages of a cut recording, up to its last valid chunk, checked against its own seals."""
    entries: list[_Entry] = []
    complete = True
    audit = SealAudit()
    try:
        reader = SealedReader(path)
        audit = reader.audit
        for topic, schema_name, message in reader:
            entries.append(
                _Entry(topic, schema_name, message.sequence, message.log_ns, message.publish_ns, message.data)
            )
    except ContainerError:
        complete = False  # the file is cut off here; resuming writes what is missing
    if entries:
        audit.check_signatures()
    if entries and (audit.binding, audit.signer) != (binding, account.address):
        raise BrokenSeal(
            "the recording belongs to another assignment or signer",
            path=str(path),
            found=str(audit.binding),
            signer=audit.signer,
        )
    if audit.final:
        if complete:
            raise RecordingSealed("the recording is finished", path=str(path))
        entries.pop()  # the final seal of a file that was killed before its index was written
    return entries
