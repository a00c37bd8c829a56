"""Errors of the local chain.

    RodeoError
    ├── RpcError                answered to the caller as a JSON-RPC error object
    │   ├── ParseError          -32700
    │   ├── InvalidRpcRequest   -32600
    │   ├── MethodNotFound      -32601
    │   ├── InvalidParams       -32602
    │   ├── InternalError       -32603
    │   │   └── ChainStoreUnwritable  no room on the disk, or the like; nothing changed
    │   ├── TransactionRejected -32000, with the wording of geth, which clients match on
    │   ├── ExecutionFailed     -32000, out of gas, invalid opcode, ...
    │   └── ExecutionReverted   3, `data` carries the revert data
    ├── ChainStoreCorrupted     the file cannot be read back
    ├── WrongGenesis            the file belongs to another chain
    ├── ChainLost               the file is gone, and contracts are known to be in it
    └── AnvilFailed             the anvil child did not start or died

Codes: JSON-RPC 2.0 section 5.1 and EIP-1474; code 3 as in geth and the execution-apis tests.
"""

from __future__ import annotations

from typing import Any

from eth_abi import decode
from eth_abi.exceptions import DecodingError

from rodeo.errors import RodeoError

ERROR_STRING_SELECTOR = bytes.fromhex("08c379a0")
"""Selector of `Error(string)`, what `require(condition, "sentence")` reverts with."""


class RpcError(RodeoError):
    """Answered to the caller; `rpc_code` and `data` become the JSON-RPC error object."""

    rpc_code = -32000

    def __init__(self, message: str, data: str | None = None) -> None:
        super().__init__(message)
        self.data = data

    def to_rpc(self) -> dict[str, Any]:
        error: dict[str, Any] = {"code": self.rpc_code, "message": self.message}
        return error if self.data is None else {**error, "data": self.data}


class ParseError(RpcError):
    """The body is not JSON."""

    rpc_code = -32700


class InvalidRpcRequest(RpcError):
    """The body is JSON, but no JSON-RPC 2.0 request, or larger than allowed."""

    rpc_code = -32600


class MethodNotFound(RpcError):
    """This node has no such method."""

    rpc_code = -32601


class InvalidParams(RpcError):
    """A parameter is missing, superfluous or does not have the encoding that the method expects."""

    rpc_code = -32602


class InternalError(RpcError):
    """The node failed at a request; its log has the trace."""

    rpc_code = -32603


class ChainStoreUnwritable(InternalError):
    """The chain's file cannot be written now. Nothing of the block is kept, and it may be sent again."""


class TransactionRejected(RpcError):
    """The transaction cannot enter a block; nothing changed."""


class ExecutionFailed(RpcError):
    """The call ended without a result for a reason other than a revert."""


class ExecutionReverted(RpcError):
    """The contract reverted; `data` is its revert data in hex."""

    rpc_code = 3

    def __init__(self, revert_data: bytes) -> None:
        super().__init__(f"execution reverted{_reason(revert_data)}", "0x" + revert_data.hex())


class ChainStoreCorrupted(RodeoError):
    """The chain's file cannot be read back. Nothing is served from it."""

    restart_cures = False


class WrongGenesis(RodeoError):
    """The chain's file was made for another chain than the site file describes."""

    restart_cures = False


class ChainLost(RodeoError):
    """The site's contracts are on a chain that is not in its file any more."""

    restart_cures = False


class AnvilFailed(RodeoError):
    """The anvil child process did not start, or ended by itself."""


def _reason(revert_data: bytes) -> str:
    if not revert_data.startswith(ERROR_STRING_SELECTOR):
        return ""
    try:
        (reason,) = decode(["string"], revert_data[4:])
    except (DecodingError, UnicodeDecodeError):
        return ""
    return f": {reason}"
