"""How a call to a contract is encoded: the base of the generated calls in contract_calls.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from eth_abi.abi import decode, encode
from eth_typing import ChecksumAddress, HexStr
from eth_utils.abi import function_abi_to_4byte_selector, get_abi_input_types, get_abi_output_types

from rodeo.chain import artifacts
from rodeo.chain.contracts.types import raw_values, value

if TYPE_CHECKING:
    from rodeo.chain.deployment import Deployment


@dataclass(frozen=True)
class Call:
    """A transaction without sender, nonce, gas and fee."""

    to: ChecksumAddress
    data: HexStr
    name: str
    """The function, for logs."""


class ContractCalls:
    """Encodes calls to the contracts of a deployment. `contract` selects one of several that are alike."""

    def __init__(self, deployment: Deployment, contract: str | None = None) -> None:
        self._deployment = deployment
        self._contract = contract

    def _call(self, contract: str, function: str, *args: Any) -> Call:
        data = functions(contract)[function].encoded(args)
        return Call(self._deployment.address(self._contract or contract), data, function)


@dataclass(frozen=True)
class Function:
    """One of a contract's functions, ready to be called: web3's own reads the whole ABI anew for each call,
    which takes longer than signing it."""

    selector: bytes
    types: list[str]
    inputs: list[dict[str, Any]]
    result_types: list[str]
    outputs: list[dict[str, Any]]

    def encoded(self, args: Sequence[Any]) -> HexStr:
        return HexStr("0x" + (self.selector + encode(self.types, raw_values(self.inputs, args))).hex())

    def decoded(self, result: bytes) -> Any:
        """What it returns, as abi.py types it; a tuple of several. Raises DecodingError for what no such
        function returns: nothing, where there is no contract."""
        raws = decode(self.result_types, result)
        found = tuple(map(value, self.outputs, raws))
        return found[0] if len(found) == 1 else found


@cache
def functions(contract: str) -> dict[str, Function]:
    """Function -> how it is called; none is overloaded."""
    return {
        entry["name"]: Function(
            function_abi_to_4byte_selector(entry),  # type: ignore[arg-type]
            get_abi_input_types(entry),  # type: ignore[arg-type]
            entry["inputs"],
            get_abi_output_types(entry),  # type: ignore[arg-type]
            entry["outputs"],
        )
        for entry in artifacts.load(contract).abi
        if entry["type"] == "function"
    }
