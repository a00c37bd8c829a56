"""Reads a recording message by message while checking it against its own seals."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rodeo.evidence.container import Container, Limits, RawMessage, limit
from rodeo.evidence.errors import BrokenSeal
from rodeo.evidence.seal import RunningHash, SealAudit, channel_digest
from rodeo.site.topics import SEAL_CHANNEL


class SealedReader:
    """Iterates (topic, schema name, message) in file order; `audit` says what the seals said so far.

    Raises ContainerError where the file stops being valid and SealError where it is not what was sealed.
    Whether the final seal came is for the caller to ask: a recording may be unfinished.
    """

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        self._limits = limits or Limits()
        self._container = Container(path, self._limits)
        self.running = RunningHash()
        self.audit = SealAudit()

    def __iter__(self) -> Iterator[tuple[str, str, RawMessage]]:
        channels: dict[int, tuple[str, str, bytes]] = {}
        unsealed_since_ns: int | None = None
        last_ns = 0
        for message in self._container.messages():
            if self.audit.final:
                raise BrokenSeal("a message follows the final seal", messages=self.running.messages)
            channel = channels.get(message.channel_id)
            if channel is None:
                channel = channels[message.channel_id] = self._channel(message.channel_id)
            topic, schema_name, digest = channel
            if not schema_name:
                limit("json_bytes", len(message.data), self._limits.json_bytes)
            if topic == SEAL_CHANNEL:
                limit("seal_bytes", len(message.data), self._limits.seal_bytes)
                limit("seals", self.audit.count + 1, self._limits.seals)
                unsealed_ns = 0 if unsealed_since_ns is None else last_ns - unsealed_since_ns
                self.audit.see(message.data, self.running, unsealed_ns)
                unsealed_since_ns = None
            else:
                if self.audit.binding is None:
                    raise BrokenSeal("the recording does not begin with the opening seal", topic=topic[:200])
                if unsealed_since_ns is None:
                    unsealed_since_ns = message.log_ns
                last_ns = message.log_ns
            self.running.add(digest, message.length_field, message.tail)
            yield topic, schema_name, message

    def _channel(self, channel_id: int) -> tuple[str, str, bytes]:
        channel = self._container.channels[channel_id]
        name, encoding, data = "", "", b""
        if channel.schema_id != 0:
            schema = self._container.schemas[channel.schema_id]
            name, encoding, data = schema.name, schema.encoding, schema.data
        digest = channel_digest(channel.topic, channel.message_encoding, name, encoding, data)
        return channel.topic, name, digest
