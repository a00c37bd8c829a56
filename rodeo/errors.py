"""The error tree. Foreign exceptions are translated into it where they enter.

    RodeoError
    ├── ConfigError             the site file or the environment is wrong
    ├── UnsafeSocketFolder      others could get at the bus's socket
    ├── RequestError            what the caller sent is wrong; nothing happened
    │   ├── MalformedJson
    │   └── InvalidRequest
    ├── BusError                the bus did not do what was asked
    │   ├── BusUnavailable
    │   ├── WrongBus            the processes there are another site's
    │   ├── NoResponder
    │   ├── QueryTimeout
    │   └── MalformedAnswer
    ├── RemoteError             the responder answered with an error; its code is kept
    ├── TaskError               a task did not end as it was waited for
    │   ├── TaskNotDone         it failed, or was cancelled
    │   └── TaskUnfinished      it is not over yet
    ├── DiskFull                there is no room to write what must be written
    ├── PortUnavailable         an address of the site file cannot be listened on
    ├── ClockUnavailable        the site's clock has not been heard
    ├── WalletError             a keystore cannot be opened
    │   └── KeystoreMissing
    ├── Interrupted             asked to stop while waiting
    ├── AlreadyRunning          another instance holds this process's lock
    └── ServedElsewhere         another process on the bus serves the same key or device

`rodeo.chain`, `rodeo.evidence` and `rodeo.ros2` add their own branches below RodeoError.
"""

from __future__ import annotations

import errno
import re
from typing import Any, ClassVar

from pydantic import ValidationError


def snake_case(name: str) -> str:
    """`InsufficientFunds` -> `insufficient_funds`: how a Python or Solidity error name becomes a code."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def wrong_fields(error: ValidationError) -> dict[str, str]:
    """Field -> what is wrong with it."""
    return {".".join(map(str, e["loc"])) or "(whole)": e["msg"] for e in error.errors()}


def unreadable(error: OSError | ValueError) -> str:
    """In a few words what is wrong with the content of a file."""
    if isinstance(error, ValidationError):
        return "; ".join(f"{field}: {problem}" for field, problem in wrong_fields(error).items())[:300]
    return str(error)[:300]


_NO_MACHINES_BYTES = 1 << 40


def is_machines(error: Exception) -> bool:
    """Whether a machine failed at what it did, and not at what it was given: no memory, a disk or a library
    that cannot be read, a setting that is wrong. The same input may succeed later, or elsewhere."""
    if isinstance(error, RodeoError):
        return error.machines
    # Libraries raise an OSError without a number for a picture or a file that is malformed.
    if isinstance(error, OSError):
        return error.errno is not None
    # numpy says how much it was asked for: what no machine has is the input's doing.
    asked_bytes = getattr(error, "_total_size", 0)
    return isinstance(error, MemoryError | ImportError) and asked_bytes < _NO_MACHINES_BYTES


class RodeoError(Exception):
    """An error with a stable code, one sentence for a person and the values that explain it."""

    restart_cures: ClassVar[bool] = True
    """Whether a process that ended on it may do better when it is started again."""
    machines: ClassVar[bool] = True
    """Whether it says nothing about what was to be read or computed, see `is_machines`."""

    def __init__(self, message: str, **details: Any) -> None:
        super().__init__(message)
        self.message = message
        self.details = details

    @property
    def code(self) -> str:
        return snake_case(type(self).__name__)

    def to_json(self) -> dict[str, Any]:
        return {"code": self.code, "message": self.message, "details": self.details}

    def __str__(self) -> str:
        if not self.details:
            return self.message
        values = ", ".join(f"{key}={value!r}" for key, value in self.details.items())
        return f"{self.message} ({values})"


class ConfigError(RodeoError):
    """The site file or the environment does not describe a valid site."""

    restart_cures = False


class UnsafeSocketFolder(RodeoError):
    """The folder of the bus's socket belongs to another user, or is open to others."""

    restart_cures = False


class RequestError(RodeoError):
    """What the caller sent is wrong. Nothing was done."""

    machines = False


class MalformedJson(RequestError):
    """The payload is not JSON, or not a JSON object."""


class InvalidRequest(RequestError):
    """The payload is JSON but does not follow the schema; `details["fields"]` says where."""


class BusError(RodeoError):
    """The bus did not do what was asked."""


class BusUnavailable(BusError):
    """No session to the router."""


class WrongBus(BusError):
    """The processes on the bus are of another site. Nothing was asked of them."""


class NoResponder(BusError):
    """Nobody serves the key."""


class QueryTimeout(BusError):
    """Somebody may serve the key, but no answer came in time."""


class MalformedAnswer(BusError):
    """The answer is no JSON object, does not fit the question, or is an error that has no code."""


class TaskError(RodeoError):
    """A task did not end as it was waited for. Carries its ID and state."""


class TaskNotDone(TaskError):
    """The task failed or was cancelled: nobody did it, and its reward went back."""


class TaskUnfinished(TaskError):
    """The task was not over within the given time."""


class RemoteError(RodeoError):
    """The responder answered with an error, which arrives here with its own code and details."""

    def __init__(self, code: str, message: str, details: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.details = details or {}  # any names, `message` among them
        self._code = code

    @property
    def code(self) -> str:
        return self._code

    @property
    def passes(self) -> bool:
        """Whether the responder, or the chain behind it, only cannot now, whatever was asked: that passes by
        the wall's time. Anything else stays refused until something happens on chain, or time passes there.
        """
        return self._code in _PASSING


_PASSING = frozenset(
    {
        "bridge_not_ready",
        "chain_reorganized",
        "chain_unavailable",
        "deployment_mismatch",
        "fee_too_high",
        "index_unusable",
        "internal",
        "journal_damaged",
        "journal_incomplete",
        "journal_unwritable",
        "not_deployed",
        "rpc_failed",
        "transaction_dropped",
        "transaction_failed",
        "transaction_timeout",
        "wrong_chain",
    }
)


class DiskFull(RodeoError):
    """There is no room for what must be written. Only that was lost; work continues once there is."""


class FolderTaken(RodeoError):
    """A folder is in use, or holds what its writer does not know and would remove."""


class PortUnavailable(RodeoError):
    """An address that the site file gives this process is taken, or is not this machine's."""

    @classmethod
    def of(cls, purpose: str, host: str, port: int, error: OSError, holder: str = "") -> PortUnavailable:
        """What listening for `purpose` raised; `holder` is the process that has the port, if it is known."""
        if error.errno == errno.EADDRINUSE:
            why = (
                f"{holder or 'another program'} uses that port: stop it, or set another port in the site file"
            )
        elif error.errno == errno.EADDRNOTAVAIL:
            why = "this machine does not have that address: correct it in the site file"
        else:
            why = error.strerror or str(error)
        return cls(f"cannot listen on {host}:{port} for {purpose}: {why}")


class ClockUnavailable(RodeoError):
    """The site's clock has not been heard yet, so there is no time to tell."""


class WalletError(RodeoError):
    """A keystore is missing, or its passphrase does not open it."""

    restart_cures = False


class KeystoreMissing(WalletError):
    """There is no keystore of this name yet."""

    restart_cures = True


class Interrupted(RodeoError):
    """The process was asked to stop while it waited for what it needs."""


class AlreadyRunning(RodeoError):
    """Another instance of this process works on the same data directory."""

    restart_cures = False


class ServedElsewhere(RodeoError):
    """Another process on the bus serves the same wallet or speaks for the same device."""

    restart_cures = False
