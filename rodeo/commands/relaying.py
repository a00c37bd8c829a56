"""Requests that one wallet signs and another one sends (decision 55), and the commands about them."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from eth_utils import keccak
from pydantic import BaseModel, Field

from rodeo.bus.messages import Message, SignedRequest, TypedSignature
from rodeo.bus.session import validate
from rodeo.chain import signed_requests
from rodeo.chain.contracts.abi import ChallengeRequest
from rodeo.chain.node.errors import ContractReverted
from rodeo.chain.signed_requests import (
    UNLIMITED,
    AbandonTask,
    AcceptTask,
    CancelTask,
    Challenge,
    Permit,
    RegisterTask,
    Said,
    SubmitProof,
    Typed,
)
from rodeo.commands.declare import Command, NameOf, Subject, command
from rodeo.commands.errors import NoPermit, NotSigned, OtherContracts
from rodeo.commands.examples import SIGNED
from rodeo.errors import InvalidRequest
from rodeo.signing import typed_data

if TYPE_CHECKING:
    from rodeo.chain.client import ChainClient
    from rodeo.chain.encoding import Call
    from rodeo.chain.signed_requests import Said
    from rodeo.commands.desk import Desk

_NONCE_BYTES = 6
"""So that JSON numbers hold a nonce in every language."""

_SIGNATURE_BYTES = 65

_VERSIONS = ("1", "2")
"""Versions of tokens that take permits: OpenZeppelin's, and Circle's USDC."""

Model = TypeVar("Model", bound=BaseModel)


Signable = Annotated[str, NameOf(lambda one: one.signable)]
"""A command that somebody else may send."""


class Sign(Message):
    """Sign a command for somebody else to send with `relay`, who pays its gas. Nothing is sent.
    `revoke_request` takes it back until it is sent, and `valid_s` ends it. Of requests with the same
    `request_id` one at most posts, accepts or gives back a task, or challenges a ruling."""

    command: Signable
    request: dict[str, Any] = Field(default_factory=dict)
    valid_s: Annotated[int, Field(ge=60, le=30 * 86_400)] = Field(
        86_400, description="How long the request may be sent, s of block time."
    )


@command("operator")
class Relay(Command):
    """Send what another participant has signed, and pay its gas. What fails changes nothing, and may be sent
    again."""

    signed: SignedRequest = Field(examples=[SIGNED])

    def calls(self, desk: Desk) -> list[Call]:
        return Requests(desk.client).calls(self.signed)

    def subject(self, desk: Desk) -> Subject:
        said = Requests(desk.client).read(self.signed)
        task_id = getattr(said, "task_id", None)
        if not isinstance(said, signed_requests.SubmitProof):
            return Subject(task_id)
        task = desk.index.tasks.get(said.task_id)
        return Subject(task_id, said.attempt, None if task is None else task["nonce"])


@command("operator")
class AllowPayments(Command):
    """Let the contracts take rewards and bonds from this wallet, of any amount. The first payment that the
    wallet sends does it, too. A wallet whose requests others send needs it if the token takes no permits."""

    def calls(self, desk: Desk) -> list[Call]:
        calls = desk.escrow_approval(UNLIMITED // 2 + 1)
        if not calls:
            raise InvalidRequest("the contracts may take payments of any amount already")
        return calls


@command("operator")
class RevokeRequest(Command):
    """Make signed requests void that were not sent yet, whatever they are about."""

    nonce: Annotated[int, Field(ge=0, lt=2**256)] = Field(
        description="That of the requests.", examples=[4711]
    )

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.calls.revoke_request(self.nonce)]


class Requests:
    """Signed requests of one deployment."""

    def __init__(self, client: ChainClient) -> None:
        self._client = client

    def typed(self, said: Said) -> Typed:
        """What is signed."""
        return said.typed_data(self._domain)

    def permit(self, owner: str, spender: str, amount: int, deadline: int) -> Typed:
        """What lets the contract `spender` take `amount` units from `owner`, and no more. Raises NoPermit."""
        client = self._client
        domain = self._token_domain(owner)
        try:
            nonce = client.token.permit_nonce(owner)
        except ContractReverted as error:
            raise self._no_permit(owner) from error
        said = Permit(owner=owner, spender=spender, value=amount, nonce=nonce, deadline=deadline)
        return said.typed_data(domain)

    def _no_permit(self, owner: str) -> NoPermit:
        return NoPermit(
            "the payment token takes no signed permits: send `allow_payments` once before, or `rodeo task "
            "allow-payments`",
            owner=owner,
            spender=self._client.task_manager,
        )

    def calls(self, signed: SignedRequest) -> list[Call]:
        """What carries it out. Raises NotSigned, NoPermit, OtherContracts or InvalidRequest."""
        said = self.read(signed)
        signature = _bytes(signed.request)
        calls = self._client.calls
        match said:
            case RegisterTask():
                request = said.request.request
                call = calls.register_task_for(said.creator, request, said.nonce, said.deadline, signature)
                return [*self._permitted(signed, said.creator, said.nonce), call]
            case CancelTask():
                cancelled = said.creator, said.task_id, said.nonce, said.deadline, signature
                return [calls.cancel_task_for(*cancelled)]
            case AcceptTask():
                back = isinstance(said, AbandonTask)
                send = calls.abandon_task_for if back else calls.accept_task_for
                return [send(said.executor, said.task_id, said.attempt, said.nonce, said.deadline, signature)]
            case SubmitProof():
                proof_hash = bytes.fromhex(said.proof_hash[2:])
                return [
                    calls.submit_proof_for(
                        said.executor,
                        said.task_id,
                        said.attempt,
                        proof_hash,
                        said.uri,
                        said.nonce,
                        said.deadline,
                        signature,
                    )
                ]
            case Challenge():
                judge = self._client.deployment.contracts.get("DisputeJudge")
                if said.judge != judge:  # whatever is called there could use up the sender's gas
                    raise OtherContracts(
                        "another contract hears challenges", judge=said.judge, expected=judge
                    )
                against = ChallengeRequest(
                    judge=said.judge,
                    task_id=said.task_id,
                    attempt=said.attempt,
                    instance=said.instance,
                    reason=said.reason,
                )
                call = calls.challenge_for(said.challenger, against, said.nonce, said.deadline, signature)
                return [*self._permitted(signed, said.challenger, said.nonce), call]

    def read(self, signed: SignedRequest) -> Said:
        """What its participant wants. Raises OtherContracts or InvalidRequest."""
        typed = signed.request.typed_data
        kind = signed_requests.SAID.get(str(typed.get("primaryType")))
        if kind is None:
            raise InvalidRequest(
                "not a request that can be sent for somebody", known=sorted(signed_requests.SAID)
            )
        return _message(kind, typed, self._domain)

    def _permitted(self, signed: SignedRequest, signer: str, nonce: int) -> list[Call]:
        """What has to be sent first: the permit, unless it is sent already or the request is void."""
        client = self._client
        if signed.permit is None or client.tasks.is_request_nonce_used(signer, nonce):
            return []
        said = _message(Permit, signed.permit.typed_data, self._token_domain(signer))
        if client.token.allowance(said.owner, said.spender) >= said.value:
            return []
        raw = _bytes(signed.permit)
        if said.nonce != (expected := client.token.permit_nonce(said.owner)):
            raise NotSigned(
                "another permit of its owner was sent since: sign the request again",
                owner=said.owner,
                signed_for_nonce=said.nonce,
                expected_nonce=expected,
            )
        if len(raw) != _SIGNATURE_BYTES:
            raise NotSigned("a permit is signed by a key, in 65 bytes", owner=said.owner, bytes=len(raw))
        r, s, v = raw[:32], raw[32:64], raw[64]
        return [self._client.calls.permit(said.owner, said.spender, said.value, said.deadline, v, r, s)]

    @property
    def _domain(self) -> Typed:
        deployment = self._client.deployment
        return signed_requests.domain(
            "RODEO SignedRequests", deployment.chain_id, deployment.address("SignedRequests")
        )

    def _token_domain(self, owner: str) -> Typed:
        """By which the token knows permits for it. Raises NoPermit where it has none, or one that such tokens
        do not have."""
        deployment = self._client.deployment
        name, address = self._client.token.name(), deployment.address("IECoin")
        try:
            said = self._client.token.permit_domain()
        except ContractReverted as error:
            raise self._no_permit(owner) from error
        for version in _VERSIONS:
            known = signed_requests.domain(name, deployment.chain_id, address, version)
            if typed_data.separator(known) == said:
                return known
        raise self._no_permit(owner)


def nonce_of(request_id: str | None) -> int:
    """The nonce of a new request; the same one again gets the same, so that it counts once."""
    if request_id is None:
        return secrets.randbits(8 * _NONCE_BYTES)
    return int.from_bytes(keccak(text=request_id)[:_NONCE_BYTES])


def _message(model: type[Model], typed: Typed, domain: Typed) -> Model:
    found = typed.get("domain")
    if found != domain:
        raise OtherContracts(
            "signed for other contracts, or for another chain", signed_for=found, expected=domain
        )
    return validate(model, typed.get("message"))


def _bytes(signature: TypedSignature) -> bytes:
    if signature.signature is None:
        raise NotSigned("nobody has signed this yet: sign `typed_data` with the participant's wallet")
    return bytes.fromhex(signature.signature[2:])
