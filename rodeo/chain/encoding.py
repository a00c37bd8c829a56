"""How a call to a contract is encoded: the base of the generated calls in contract_calls.py."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from eth_abi.abi import encode
from eth_typing import ChecksumAddress, HexStr
from eth_utils.abi import function_abi_to_4byte_selector, get_abi_input_types

from rodeo.chain import artifacts
from rodeo.chain.contracts.types import raw_values

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
        # Not web3's encode_abi: it reads the whole ABI anew, which takes longer than signing.
        selector, types, inputs = functions(contract)[function]
        data = "0x" + (selector + encode(types, raw_values(inputs, args))).hex()
        return Call(self._deployment.address(self._contract or contract), HexStr(data), function)


@cache
def functions(contract: str) -> dict[str, tuple[bytes, list[str], list[dict[str, Any]]]]:
    """Function -> its selector, the types of its parameters, and the parameters; none is overloaded."""
    return {
        entry["name"]: (
            function_abi_to_4byte_selector(entry),  # type: ignore[arg-type]
            get_abi_input_types(entry),  # type: ignore[arg-type]
            entry["inputs"],
        )
        for entry in artifacts.load(contract).abi
        if entry["type"] == "function"
    }
