"""A token that is on the chain before the organization: no permit, any number of decimals."""

from __future__ import annotations

import json
from pathlib import Path

from eth_abi import encode
from web3 import HTTPProvider, Web3
from web3.types import HexBytes, TxParams
from web3.utils import get_create_address

_CODE = json.loads((Path(__file__).with_suffix(".json")).read_text())["bytecode"]
"""Init code of contracts/test/PlainToken.sol, as Foundry builds it: `contracts/out/PlainToken.sol`."""

_RICH = "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266"
"""The first account of local chains, which they hold themselves."""

ADDRESS = str(get_create_address(_RICH, 0))
"""Where the first contract of a local chain is."""

_ABI = [
    {
        "type": "function",
        "name": name,
        "stateMutability": "nonpayable",
        "inputs": [{"name": "account", "type": "address"}, {"name": "amount", "type": "uint256"}],
        "outputs": [],
    }
    for name in ("mint",)
]


def create(w3: Web3, init_code: bytes) -> str:
    """Address of the contract that `init_code` makes, on a local chain."""
    sent = w3.eth.send_transaction({"from": Web3.to_checksum_address(_RICH), "data": HexBytes(init_code)})
    made = w3.eth.wait_for_transaction_receipt(sent)["contractAddress"]
    assert made is not None
    return str(made)


def init_code(decimals: int) -> bytes:
    return HexBytes(_CODE) + encode(["uint8"], [decimals])


class PlainToken:
    """The token on the chain of the node at `url`; the first transaction there makes it."""

    def __init__(self, url: str, decimals: int) -> None:
        self._w3 = Web3(HTTPProvider(url))
        assert self._w3.eth.accounts[0] == _RICH
        assert create(self._w3, init_code(decimals)) == ADDRESS
        self._contract = self._w3.eth.contract(Web3.to_checksum_address(ADDRESS), abi=_ABI)

    def mint(self, account: str, units: int) -> None:
        self._send(
            {"to": self._contract.address, "data": self._contract.encode_abi("mint", [account, units])}
        )

    def _send(self, what: TxParams) -> None:
        sent = self._w3.eth.send_transaction({"from": Web3.to_checksum_address(_RICH), **what})
        assert self._w3.eth.wait_for_transaction_receipt(sent)["status"] == 1
