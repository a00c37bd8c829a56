"""A participant's wallet: carries out its commands, signs for it, or prepares what it signs elsewhere."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from eth_account import Account
from eth_utils import to_checksum_address

from rodeo.bus.messages import ORGANIZATION, Broadcast, Prepare, SignedRequest, TypedSignature
from rodeo.bus.session import validate
from rodeo.chain import signed_requests
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.chain.encoding import Call
from rodeo.commands import COMMANDS, Command
from rodeo.commands.desk import Desk
from rodeo.commands.errors import CannotSign
from rodeo.commands.judging import SignVote
from rodeo.commands.relaying import Requests, Sign, nonce_of
from services.bridge.errors import NotThisWallets, UnknownCommand
from services.bridge.journal import decoded
from services.bridge.orders import Order
from services.bridge.transactions import Transactions

KNOWN = frozenset({*COMMANDS, "prepare", "broadcast", "sign", "sign_vote"})
"""Names of all that a wallet accepts."""

Reply = dict[str, Any]


@dataclass
class Wallet:
    """A participant's commands. `execute` is used by one thread, the participant's own."""

    desk: Desk
    transactions: Transactions

    @property
    def participant(self) -> str:
        return self.desk.participant

    def execute(self, name: str, data: dict[str, Any]) -> Reply | Future[Reply]:
        """Carry out the command `name`; its reply, now or once mined.

        The same `request_id` again gives the same reply. Raises RequestError before anything was sent, and
        what `Orders` and `Signer` raise.
        """
        match name:
            case "prepare":
                return self._prepare(validate(Prepare, data))
            case "broadcast":
                return self._broadcast(validate(Broadcast, data))
            case "sign":
                return self._sign(validate(Sign, data))
            case "sign_vote":
                signed = validate(SignVote, data).signed(self.desk, self._queue.account)
                return signed.model_dump(mode="json")
        command = parse(name, data)
        if command.dry_run:
            orders = self.orders(command)
            calls = [order.call.name for order in orders]
            # What comes after the first depends on it.
            return {"dry_run": True, "calls": calls, **self.transactions.signer.cost(orders[0])}
        if (known := self._before(command)) is not None:
            return self.transactions.orders.submit(known)
        *before, order = self.orders(command)
        if before:  # a task that was cancelled to be posted for more would be gone
            self.transactions.signer.check_spending(order)
        for first in before:
            self.transactions.orders.submit(first).result()
        sent = self.transactions.orders.submit(order)
        command.sent(self.desk, sent)
        return sent

    def orders(self, command: Command) -> list[Order]:
        """Orders to send one after the other; the last is the command's own. Raises RequestError."""
        name = command.declared.name
        if command.declared.of_administrator:
            self.desk.require_no_timelock(name)
        *before, call = command.calls(self.desk)
        about = command.subject(self.desk)
        return [
            *(Order(self.participant, one.name, one) for one in before),
            Order(
                self.participant,
                name,
                call,
                command.request_id,
                _content_sha256(command),
                about.task_id,
                command.spends(self.desk),
                about.attempt,
                about.nonce,
            ),
        ]

    @property
    def _queue(self) -> Any:
        return self.transactions.orders.wallets[self.participant]

    def _before(self, command: Command) -> Order | None:
        """The order of the same request when it was made before: its checks do not hold any more."""
        if command.request_id is None:
            return None
        content = _content_sha256(command)
        entry = self.transactions.orders.find(self.participant, command.request_id, content)
        if entry is None:
            return None
        name = command.declared.name
        return Order(self.participant, name, Call(entry.to, "0x", name), command.request_id, content)  # type: ignore[arg-type]

    # -- a wallet that lives elsewhere ---------------------------------------------------------------------

    def _prepare(self, request: Prepare) -> Reply:
        """The transaction to sign, or the signed one where this request was broadcast before."""
        command = parse(request.command, request.request)
        content = _content_sha256(command)
        if command.request_id is not None:
            entry = self.transactions.orders.find(self.participant, command.request_id, content)
            if entry is not None:
                return {"raw": "0x" + entry.raw.hex(), "content_sha256": content, "remaining": 0}
        first, *others = orders = self.orders(command)
        self.transactions.signer.check_spending(orders[-1])
        return {
            "transaction": self.transactions.signer.unsigned(first),
            "content_sha256": first.content_sha256,
            "remaining": len(others),
        }

    def _broadcast(self, request: Broadcast) -> Future[Reply]:
        raw = bytes.fromhex(request.raw[2:])
        try:
            fields = decoded(raw)
            signer = Account.recover_transaction(raw)
        except Exception as error:
            # rlp, eth_keys and eth_account each raise their own types on hostile bytes; all mean the same.
            raise NotThisWallets(
                "this is not a signed transaction of type 2", problem=repr(error)[:200]
            ) from error
        deployment = self.desk.client.deployment
        to = to_checksum_address(fields["to"] or ZERO_ADDRESS)
        found = (signer, fields.get("chainId"), to in deployment.contracts.values())
        if found != (self.desk.key_address, deployment.chain_id, True) or "maxFeePerGas" not in fields:
            raise NotThisWallets(
                "not signed by this participant for this chain and these contracts",
                signer=signer,
                expected_signer=self.desk.key_address,
                chain_id=fields.get("chainId"),
                expected_chain_id=deployment.chain_id,
                to=to,
            )
        call = Call(to, "0x" + bytes(fields["data"]).hex(), "broadcast")  # type: ignore[arg-type]
        digest = sha256(raw).hexdigest()
        request_id, content = request.request_id or digest, request.content_sha256 or digest
        return self.transactions.orders.broadcast(
            Order(self.participant, "broadcast", call, request_id, content), raw
        )

    # -- what somebody else sends ---------------------------------------------------------------------------

    def _sign(self, request: Sign) -> Reply:
        """What `relay` sends; without signatures for a wallet that signs for itself."""
        wallet = self._queue
        if self.participant == ORGANIZATION:
            raise CannotSign("the organization is a contract that signs nothing: its operators send")
        if wallet.limits.has_daily:
            raise CannotSign("what others send cannot be counted against the wallet's daily limit")
        command = parse(request.command, request.request)
        desk, requests = self.desk, Requests(self.desk.client)
        deadline = int(desk.index.position.block_time_s) + request.valid_s
        said, permit = command.to_sign(desk, nonce_of(command.request_id), deadline), None
        taker, amount = command.takes(desk)
        if amount and desk.approval(taker, amount):
            permit = requests.permit(desk.address, taker, amount, deadline)
        signed = SignedRequest(
            request=TypedSignature(typed_data=requests.typed(said)),
            permit=None if permit is None else TypedSignature(typed_data=permit),
        )
        if wallet.account is not None:
            signed = signed_requests.sign(signed, wallet.account)
        return signed.model_dump(mode="json")


def parse(name: str, data: dict[str, Any]) -> Command:
    """Raises UnknownCommand, InvalidRequest."""
    if name not in COMMANDS:
        raise UnknownCommand("no such command", command=name, known=sorted(KNOWN))
    return validate(COMMANDS[name], data)


def _content_sha256(command: Command) -> str:
    # The nonce of a proof's assignment is in the proof.
    content = command.model_dump_json(exclude={"request_id", "dry_run", "nonce"})
    return sha256(f"{command.declared.name} {content}".encode()).hexdigest()
