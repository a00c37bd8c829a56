"""Requests that a participant signs (EIP-712) for somebody else to send, who pays the gas; as wallets show
them."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from eth_utils import to_checksum_address
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainSerializer, StringConstraints
from pydantic.alias_generators import to_camel

from rodeo.bus.messages import SignedRequest, TypedSignature
from rodeo.chain.contracts.abi import TaskRequest
from rodeo.chain.contracts.types import bytes32_to_kind, kind_to_bytes32
from rodeo.signing import keys, typed_data

UNLIMITED = 2**256 - 1


def _kind(word: str) -> str:
    raw = bytes.fromhex(word[2:])
    if kind_to_bytes32(bytes32_to_kind(raw)) != raw:
        raise ValueError("not the name of a kind of work")
    return word


def _text(text: str) -> str:
    text.encode()  # raises UnicodeEncodeError, which is a ValueError
    return text


# Decimal strings in JSON: programs that are not Python's round greater numbers than 2^53.
_AS_TEXT = PlainSerializer(str, when_used="json")
_Number = Annotated[int, Field(ge=0, le=UNLIMITED), _AS_TEXT]
_Uint32 = Annotated[int, Field(ge=0, lt=2**32), _AS_TEXT]
_Uint8 = Annotated[int, Field(ge=0, lt=2**8), _AS_TEXT]
_Address = Annotated[
    str, StringConstraints(pattern=r"^0x[0-9a-fA-F]{40}$"), AfterValidator(to_checksum_address)
]
_Bytes32 = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-f]{64}$")]
_Text = Annotated[str, AfterValidator(_text)]

Typed = dict[str, Any]
"""EIP-712 typed data, as `eth_signTypedData_v4` takes it: types, primaryType, domain and message."""


class _Said(BaseModel):
    """A message, under the names that it has on chain."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, alias_generator=to_camel, validate_by_name=True, validate_by_alias=True
    )
    types: ClassVar[dict[str, str]]
    """Struct -> its fields as Solidity writes them."""

    def typed_data(self, domain: Typed) -> Typed:
        """The data that its participant signs, for the contract of `domain` alone."""
        types = {**self.types, "EIP712Domain": _DOMAIN}
        return {
            "types": {name: _fields(text) for name, text in types.items()},
            "primaryType": type(self).__name__,
            "domain": domain,
            "message": self.model_dump(mode="json", by_alias=True),
        }


_DOMAIN = "string name,string version,uint256 chainId,address verifyingContract"


class TypedTask(_Said):
    """A task's `TaskRequest`."""

    kind: Annotated[_Bytes32, AfterValidator(_kind)]
    reward: _Number
    execution_window: _Uint32
    verdict_window: _Uint32
    max_attempts: _Uint8
    rules: _Bytes32
    service_id: _Uint32
    provider: _Address
    params: _Text

    @classmethod
    def of(cls, request: TaskRequest) -> TypedTask:
        fields = vars(request) | {
            "kind": "0x" + kind_to_bytes32(request.kind).hex(),
            "rules": "0x" + request.rules.hex(),
        }
        return cls.model_validate(fields)

    @property
    def request(self) -> TaskRequest:
        fields = dict(self) | {
            "kind": bytes32_to_kind(bytes.fromhex(self.kind[2:])),
            "rules": bytes.fromhex(self.rules[2:]),
        }
        return TaskRequest(**fields)


class RegisterTask(_Said):
    """`creator` posts a task. At most one of the requests with the same `nonce` is carried out."""

    types = {
        "RegisterTask": "address creator,TaskRequest request,uint256 nonce,uint256 deadline",
        "TaskRequest": "bytes32 kind,uint256 reward,uint32 executionWindow,uint32 verdictWindow,"
        "uint8 maxAttempts,bytes32 rules,uint32 serviceId,address provider,string params",
    }
    creator: _Address
    request: TypedTask
    nonce: _Number
    deadline: _Number
    """Block time in s, as every deadline here."""


class CancelTask(_Said):
    """`creator` cancels an open task."""

    types = {"CancelTask": "address creator,uint256 taskId,uint256 nonce,uint256 deadline"}
    creator: _Address
    task_id: _Number
    nonce: _Number
    deadline: _Number


_ATTEMPT = "address executor,uint256 taskId,uint8 attempt,uint256 nonce,uint256 deadline"


class AcceptTask(_Said):
    """`executor` accepts the task that it is assigned."""

    types = {"AcceptTask": _ATTEMPT}
    executor: _Address
    task_id: _Number
    attempt: _Uint8
    nonce: _Number
    deadline: _Number


class AbandonTask(AcceptTask):
    """`executor` gives it back."""

    types = {"AbandonTask": _ATTEMPT}


class SubmitProof(_Said):
    """`executor` hands in a proof."""

    types = {
        "SubmitProof": "address executor,uint256 taskId,uint8 attempt,bytes32 proofHash,string uri,"
        "uint256 nonce,uint256 deadline"
    }
    executor: _Address
    task_id: _Number
    attempt: _Uint8
    proof_hash: _Bytes32
    uri: _Text
    nonce: _Number
    deadline: _Number


class Challenge(_Said):
    """`challenger` challenges the ruling of one instance, and pays the stake to `judge`, which hears it."""

    types = {
        "Challenge": "address challenger,address judge,uint256 taskId,uint8 attempt,uint8 instance,"
        "string reason,uint256 nonce,uint256 deadline"
    }
    challenger: _Address
    judge: _Address
    task_id: _Number
    attempt: _Uint8
    instance: _Uint8
    reason: _Text
    nonce: _Number
    deadline: _Number


class Permit(_Said):
    """`owner` lets `spender` take tokens (ERC-2612)."""

    types = {"Permit": "address owner,address spender,uint256 value,uint256 nonce,uint256 deadline"}
    owner: _Address
    spender: _Address
    value: _Number
    nonce: _Number
    deadline: _Number


Said = RegisterTask | CancelTask | AcceptTask | AbandonTask | SubmitProof | Challenge

SAID: dict[str, type[Said]] = {
    one.__name__: one for one in (RegisterTask, CancelTask, AcceptTask, AbandonTask, SubmitProof, Challenge)
}
"""Primary type -> what `SignedRequests` carries out."""


def domain(name: str, chain_id: int, contract: str, version: str = "1") -> Typed:
    """The EIP-712 domain of one contract on one chain."""
    return {"name": name, "version": version, "chainId": chain_id, "verifyingContract": contract}


def sign(request: SignedRequest, signer: keys.Signer) -> SignedRequest:
    """`request` with the signatures of `signer`, 65 bytes each."""

    def signed(one: TypedSignature) -> TypedSignature:
        signature = keys.sign(typed_data.digest(one.typed_data), signer)
        return TypedSignature(typed_data=one.typed_data, signature=signature)

    permit = None if request.permit is None else signed(request.permit)
    return SignedRequest(request=signed(request.request), permit=permit)


def _fields(text: str) -> list[dict[str, str]]:
    return [dict(zip(("type", "name"), field.split(" "), strict=True)) for field in text.split(",")]
