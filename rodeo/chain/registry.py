"""The contract that creates organizations of this release, at addresses known beforehand, and lists them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from eth_abi.abi import encode
from eth_typing import ChecksumAddress, HexStr
from eth_utils import keccak, to_bytes, to_checksum_address
from web3 import Web3

from rodeo.chain import artifacts
from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import NotDeployed
from rodeo.chain.node.translation import translated

PARTS = tuple(
    name
    for name in (*artifacts.CONTRACTS, *artifacts.DISPUTES, *artifacts.GOVERNANCE)
    if name not in artifacts.CREATED_BY
)
"""Contracts that it creates, each in an order in which its constructor finds those that it asks."""

PROXY = to_checksum_address("0x4e59b44847b379578588920ca78fbf26c0b4956c")
"""The deterministic deployment proxy: creates what follows a salt of 32 bytes, by CREATE2 (EIP-1014). It is
at this address on most chains, and on anvil from the beginning
(https://github.com/Arachnid/deterministic-deployment-proxy)."""

PROXY_TRANSACTION = HexStr(
    "0xf8a58085174876e800830186a08080b853604580600e600039806000f350fe7fffffffffffffffffffffffffffffffff"
    "ffffffffffffffffffffffffffffffe03601600081602082378035828234f58015156039578182fd5b80825250505060"
    "14600cf31ba02222222222222222222222222222222222222222222222222222222222222222a0222222222222222222"
    "2222222222222222222222222222222222222222222222"
)
"""Creates PROXY on a chain that has none. Nobody has the key of its sender: the signature was chosen."""

PROXY_SENDER = to_checksum_address("0x3fab184622dc19b6109349b94811493bf2a45362")
PROXY_COST_WEI = 100_000 * 100 * 10**9
"""Gas and gas price of PROXY_TRANSACTION."""

_SALT = bytes(32)


@dataclass(frozen=True)
class Part:
    """One contract on its way to the chain."""

    name: str
    """One of PARTS."""
    arguments: bytes
    """The arguments of its constructor, ABI-encoded."""

    @property
    def code(self) -> bytes:
        """Its creation code, without arguments."""
        return artifacts.load(self.name).bytecode

    @property
    def init_code_hash(self) -> bytes:
        """32 bytes"""
        return keccak(self.code + self.arguments)


@dataclass(frozen=True)
class Founding:
    """An organization in the list."""

    founder: ChecksumAddress
    name: str
    number: int
    """Tells organizations of one founder and name apart."""
    founded_in: int
    """The block of its first contract, as contracts count (see `Registry.founding_block`)."""
    address: ChecksumAddress
    """Address of its contract Organization, which may not be there yet."""


def part(name: str, *arguments: Any) -> Part:
    """Contract `name` with the arguments of its constructor."""
    constructor = [entry for entry in artifacts.load(name).abi if entry["type"] == "constructor"]
    types = [_type(parameter) for entry in constructor for parameter in entry["inputs"]]
    return Part(name, encode(types, arguments))


def _type(parameter: dict[str, Any]) -> str:
    if not parameter["type"].startswith("tuple"):
        return str(parameter["type"])
    fields = ",".join(map(_type, parameter["components"]))
    return f"({fields}){parameter['type'].removeprefix('tuple')}"


def creation_code() -> bytes:
    """Creation code of the registry of this release, with its arguments: the hashes of the code that it
    creates."""
    hashes = [keccak(artifacts.load(name).bytecode) for name in PARTS]
    made = encode(["bytes32[]", "bytes32[]"], [[_bytes32(name) for name in PARTS], hashes])
    return artifacts.load(artifacts.REGISTRY).bytecode + made


def creation_data() -> HexStr:
    """Data that PROXY is sent to create the registry."""
    return HexStr("0x" + (_SALT + creation_code()).hex())


def known_address() -> ChecksumAddress:
    """Where the registry of this release is on each chain that has PROXY, once it was created there."""
    # EIP-1014
    made_of = b"\xff" + to_bytes(hexstr=PROXY) + _SALT + keccak(creation_code())
    return to_checksum_address(keccak(made_of)[12:])


class Registry:
    """The registry at `address` on the node of `w3`. Methods that ask the node raise ChainUnavailable."""

    def __init__(self, w3: Web3, address: ChecksumAddress) -> None:
        self.address = address
        self._w3 = w3
        self._contract = w3.eth.contract(address=address, abi=artifacts.load(artifacts.REGISTRY).abi)

    @property
    def is_there(self) -> bool:
        """Whether the registry of this very release is there: it creates this code and no other."""
        with translated():
            code = bytes(self._w3.eth.get_code(self.address))
            if not artifacts.load(artifacts.REGISTRY).matches(code):
                return False
            return all(
                bytes(self._contract.functions.codeHashOf(_bytes32(name)).call())
                == keccak(artifacts.load(name).bytecode)
                for name in PARTS
            )

    def addresses(
        self, founder: str, name: str, number: int, parts: Sequence[str]
    ) -> dict[str, ChecksumAddress]:
        """Part -> where it is, or will be."""
        with translated():
            return {
                one: self._contract.functions.addressOf(
                    to_checksum_address(founder), _bytes32(name), number, _bytes32(one)
                ).call()
                for one in parts
            }

    def founded_in(self, founder: str, name: str, number: int) -> int:
        """The block of the organization's first contract, as contracts count; 0 if it has none."""
        with translated():
            founded_in: int = self._contract.functions.foundedIn(
                to_checksum_address(founder), _bytes32(name), number
            ).call()
        return founded_in

    def founding_block(self, founder: str, name: str, number: int) -> int:
        """The same as the node counts. On Arbitrum contracts read Ethereum's block numbers, which are others
        (https://docs.arbitrum.io/arbitrum-essentials/arbitrum-vs-ethereum/block-numbers-and-time). Raises
        RpcFailed where that needs more events than the node answers at once."""
        said = self.founded_in(founder, name, number)
        with translated():
            head = self._w3.eth.block_number
            event = self._contract.events.OrganizationFounded
            named = {"founder": to_checksum_address(founder), "name": _bytes32(name)}
            for first, last in ((said, said), (0, head)):
                if last > head:
                    continue
                for log in event.get_logs(from_block=first, to_block=last, argument_filters=named):
                    if log["args"]["number"] == number:
                        return int(log["blockNumber"])
        raise NotDeployed("this organization was not founded here", founder=founder, name=name, number=number)

    def init_code_hash(self, created: ChecksumAddress) -> bytes | None:
        """Hash of the creation code of a contract that was created here; None where there is none."""
        with translated():
            found = bytes(self._contract.functions.initCodeHashOf(created).call())
        return found if any(found) else None

    @property
    def count(self) -> int:
        """How many organizations were founded."""
        with translated():
            count: int = self._contract.functions.organizationCount().call()
        return count

    def organizations(self, newest: int | None = None) -> list[Founding]:
        """In the order of their founding; only this many of the `newest`, as founding one costs little."""
        count = self.count
        with translated():
            functions = self._contract.functions
            first = 0 if newest is None else max(0, count - newest)
            found = [functions.organization(k).call() for k in range(first, count)]
            return [
                Founding(
                    founder,
                    _text(name),
                    number,
                    founded_in,
                    functions.addressOf(founder, name, number, _bytes32("Organization")).call(),
                )
                for founder, number, founded_in, name in found
            ]

    def create(self, name: str, number: int, parts: Sequence[Part]) -> Call:
        """The transaction of the founder that creates these."""
        sent = [(_bytes32(one.name), one.code, one.arguments) for one in parts]
        data = self._contract.encode_abi("create", [_bytes32(name), number, sent])
        return Call(self.address, data, "create")


def _bytes32(text: str) -> bytes:
    """ASCII, as Solidity reads it in a bytes32; a longer one by its hash."""
    return text.encode().ljust(32, b"\0") if len(text) <= 32 else keccak(text=text)


def _text(word: bytes) -> str:
    """Bytes chosen by anybody; a hash, and bytes that are no text, in hex."""
    text = bytes(word).rstrip(b"\0").decode("ascii", "replace")
    return text if text.isprintable() and text.isascii() else "0x" + bytes(word).hex()
