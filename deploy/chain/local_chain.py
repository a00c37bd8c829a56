"""The chain itself: one transaction, one block, mined as it arrives and durable before it is acknowledged.

Execution is py-evm's (Prague rules). What differs from eth-tester's own front end, and why: transactions
and logs are found by index instead of by scanning every block, so the cost of a transaction does not grow
with the chain; reverts keep their data; time is the site's.

Not thread-safe: one worker thread owns it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from eth import constants
from eth.abc import (
    BlockAPI,
    BlockHeaderAPI,
    ComputationAPI,
    MiningChainAPI,
    ReceiptAPI,
    SignedTransactionAPI,
    StateAPI,
)
from eth.db.atomic import AtomicDB
from eth.db.schema import SchemaV1
from eth.exceptions import HeaderNotFound, Revert, TransactionNotFound
from eth.vm import mnemonics, opcode_values
from eth.vm.forks import PragueVM
from eth.vm.forks.prague.computation import PragueComputation
from eth.vm.forks.prague.state import PragueState
from eth.vm.opcode import as_opcode
from eth.vm.spoof import SpoofTransaction
from eth_account import Account
from eth_account.signers.local import LocalAccount
from eth_tester.backends.pyevm.main import PyEVMBackend
from eth_utils import ValidationError
from rlp.exceptions import RLPException

from deploy.chain.errors import (
    ChainStoreCorrupted,
    ExecutionFailed,
    ExecutionReverted,
    TransactionRejected,
    WrongGenesis,
)
from deploy.chain.store import Store, StoredLog

log = logging.getLogger(__name__)

DEV_MNEMONIC = "test test test test test test test test test test test junk"
"""The mnemonic that anvil and Hardhat use, so that the same dev accounts exist on every local chain."""

DEV_HD_PATH = "m/44'/60'/0'/0"

PRIORITY_FEE_WEI = 10**9
"""Suggestion of eth_maxPriorityFeePerGas. Nobody competes for blocks here; any value would do."""

_CALL_STIPEND = 2_300
"""Gas that a call with value gets on top (Yellow Paper, G_callstipend)."""

_SHALLOW = 4
"""Calls within calls up to which what each keeps back for its caller is added to an estimate untried: 6 %."""

_BLOB_TRANSACTION = 3

MAX_WAITING = 64
"""Transactions of one account whose nonces are not due yet; same limit as geth's."""


@dataclass(frozen=True)
class Call:
    """A message to execute without a signature, as eth_call and eth_estimateGas take it."""

    sender: bytes
    to: bytes
    """20 bytes, or empty to create a contract."""
    data: bytes
    value: int
    gas: int | None


class LocalChain:
    """The chain in `store`, made there when the store is new.

    `now_s()` is the site's time in whole seconds, None while it is not known: blocks then keep the time of
    their parent, so that block time never runs ahead of the site's clock. `genesis_time_s` is used once.

    Raises WrongGenesis when the store holds a chain with another id, ChainStoreCorrupted when it cannot be
    read back.
    """

    def __init__(
        self, store: Store, chain_id: int, genesis_time_s: int, now_s: Callable[[], int | None]
    ) -> None:
        self.chain_id = chain_id
        self._store = store
        self._now_s = now_s
        backend = PyEVMBackend.from_mnemonic(DEV_MNEMONIC, hd_path=DEV_HD_PATH)
        self.dev_accounts: dict[bytes, LocalAccount] = {
            key.public_key.to_canonical_address(): Account.from_key(key.to_bytes())
            for key in backend.account_keys
        }
        rules = _chain_class(type(backend.chain), chain_id)
        database = AtomicDB(store)
        if SchemaV1.make_canonical_head_hash_lookup_key() in store:
            self._chain = self._reopen(rules, database)
        else:
            parameters = PyEVMBackend.generate_genesis_params({"timestamp": genesis_time_s})
            # Random, so that a chain that was deleted and made again is seen to be another one.
            parameters["extra_data"] = _signature(chain_id) + os.urandom(8).hex().encode()
            state = PyEVMBackend.generate_genesis_state(mnemonic=DEV_MNEMONIC, hd_path=DEV_HD_PATH)
            self._chain = rules.from_genesis(database, parameters, state)
            store.commit()
        self._head: BlockHeaderAPI = self._chain.get_canonical_head()
        self._waiting: dict[bytes, dict[int, SignedTransactionAPI]] = {}

    @staticmethod
    def _reopen(rules: type[MiningChainAPI], database: AtomicDB) -> MiningChainAPI:
        try:
            chain = rules(database)
            genesis = chain.get_canonical_block_header_by_number(0)
        except (KeyError, ValueError, HeaderNotFound, RLPException) as error:
            raise ChainStoreCorrupted(
                "the chain file lacks blocks that it should hold", problem=repr(error)
            ) from error
        if not genesis.extra_data.startswith(_signature(rules.chain_id)):
            raise WrongGenesis(
                "the chain file belongs to another chain",
                expected=_signature(rules.chain_id).decode(),
                found=genesis.extra_data.decode(errors="replace"),
                genesis_hash=genesis.hash.hex(),
            )
        return chain

    # Blocks -----------------------------------------------------------------------------------------------

    @property
    def head(self) -> BlockHeaderAPI:
        """Header of the newest block."""
        return self._head

    def header(self, number: int) -> BlockHeaderAPI | None:
        """None when there is no such block (yet)."""
        if number == self._head.block_number:
            return self._head
        if number > self._head.block_number:
            return None
        return self._chain.get_canonical_block_header_by_number(number)

    def header_by_hash(self, block_hash: bytes) -> BlockHeaderAPI | None:
        try:
            return self._chain.get_block_header_by_hash(block_hash)
        except HeaderNotFound:
            return None

    def block(self, header: BlockHeaderAPI) -> BlockAPI:
        return self._chain.get_block_by_header(header)

    def receipts(self, block: BlockAPI) -> Sequence[ReceiptAPI]:
        return block.get_receipts(self._chain.chaindb)

    def find_transaction(self, transaction_hash: bytes) -> tuple[BlockAPI, int] | None:
        """The block that holds it and its index there."""
        located = self._locate(transaction_hash)
        if located is None:
            return None
        number, index = located
        return self.block(self._chain.get_canonical_block_header_by_number(number)), index

    def _locate(self, transaction_hash: bytes) -> tuple[int, int] | None:
        try:
            return self._chain.chaindb.get_transaction_index(transaction_hash)
        except TransactionNotFound:
            return None

    def logs(self, first: int, last: int, addresses: Sequence[bytes] = ()) -> list[StoredLog]:
        """Logs of the inclusive range of blocks, of `addresses` or of all."""
        return self._store.logs(first, last, addresses)

    # State ------------------------------------------------------------------------------------------------

    def state(self, header: BlockHeaderAPI) -> StateAPI:
        """Accounts and storage as the block left them."""
        return self._chain.get_vm(header).state

    def next_header(self) -> BlockHeaderAPI:
        """Header of the block that would be mined now: the pending block, empty."""
        header = self._chain.create_header_from_parent(self._head)
        return header.copy(timestamp=self._next_timestamp(), mix_hash=os.urandom(32))

    def pending_block(self) -> BlockAPI:
        """The block that would be mined now. Empty: every transaction is mined as it arrives."""
        return self._chain.get_vm(self.next_header()).get_block()

    def call(self, call: Call, header: BlockHeaderAPI) -> bytes:
        """Output of `call` on top of the block. Raises ExecutionReverted or ExecutionFailed."""
        computation, _ = self._simulate(call, header, call.gas or header.gas_limit)
        _raise_on_error(computation)
        return computation.output

    def estimate_gas(self, call: Call, header: BlockHeaderAPI) -> int:
        """Gas with which `call` succeeds, a few percent above the least. Raises like `call`."""
        ceiling = call.gas or header.gas_limit
        if not call.data and call.to and not self.state(header).get_code(call.to):
            return 21_000
        computation, gas_used = self._simulate(call, header, ceiling)
        _raise_on_error(computation)
        # A call passes on 63/64 of what is left (EIP-150): this is enough for calls within calls, unless
        # the code asks for more gas than it uses.
        depth = _depth(computation)
        if depth <= _SHALLOW and not _watches_gas(computation):
            return min((gas_used + _CALL_STIPEND) * 64**depth // 63**depth + 1, ceiling)
        # Same first guess as geth's.
        low, high = (gas_used + _CALL_STIPEND) * 64 // 63, ceiling
        if low < ceiling and self._succeeds(call, header, low):
            return low
        while high - low > low // 64:
            middle = (low + high) // 2
            low, high = (low, middle) if self._succeeds(call, header, middle) else (middle, high)
        return high

    def _succeeds(self, call: Call, header: BlockHeaderAPI, gas: int) -> bool:
        return not self._simulate(call, header, gas)[0].is_error

    def _simulate(self, call: Call, header: BlockHeaderAPI, gas: int) -> tuple[ComputationAPI, int]:
        """Execute and forget; also the gas used before refunds, calldata floor (EIP-7623) included."""
        vm = self._chain.get_vm(header.copy(base_fee_per_gas=0))
        message = self._chain.get_transaction_builder().create_unsigned_transaction(
            nonce=vm.state.get_nonce(call.sender),
            gas_price=0,
            gas=gas,
            to=call.to,
            value=call.value,
            data=call.data,
        )
        try:
            computation = vm.state.apply_transaction(SpoofTransaction(message, from_=call.sender))
        except ValidationError as error:
            raise ExecutionFailed(str(error)) from error
        used = gas - computation.get_gas_remaining() + computation.data_floor_gas
        return computation, used

    # Writing ----------------------------------------------------------------------------------------------

    def send_raw(self, raw: bytes) -> bytes:
        """Mine the signed transaction; its hash. Raises TransactionRejected, and then nothing has changed.

        One whose nonce is not due yet waits, in memory, for those before it, as in a node's queue.
        """
        transaction = self._decode(raw)
        if self._take(transaction):
            self._mine_waiting(transaction.sender)
        else:
            self._wait(transaction)
        return transaction.hash

    def _take(self, transaction: SignedTransactionAPI) -> bool:
        """Mine it; False when its nonce is not due yet. Raises TransactionRejected."""
        header = self.next_header()
        if not self._check(transaction, header):
            return False
        try:
            self._mine(header, [transaction])
        except ValidationError as error:
            raise TransactionRejected(str(error)) from error
        return True

    def _wait(self, transaction: SignedTransactionAPI) -> None:
        waiting = self._waiting.setdefault(transaction.sender, {})
        before = waiting.get(transaction.nonce)
        if before is None and len(waiting) >= MAX_WAITING:
            raise TransactionRejected("account limit exceeded: too many queued transactions")
        # Nodes want 10 % more for a place that is taken (geth's price bump).
        least = 0 if before is None or before.hash == transaction.hash else before.max_fee_per_gas * 11
        if transaction.max_fee_per_gas * 10 < least:
            raise TransactionRejected("replacement transaction underpriced")
        waiting[transaction.nonce] = transaction

    def _mine_waiting(self, sender: bytes) -> None:
        """Transactions that waited for the one that has just been mined."""
        waiting = self._waiting.get(sender, {})
        while (following := waiting.pop(self.state(self._head).get_nonce(sender), None)) is not None:
            try:
                self._take(following)
            except TransactionRejected as rejection:
                log.warning("dropped a queued transaction: %s", rejection)
        if not waiting:
            self._waiting.pop(sender, None)

    def mine_empty(self) -> None:
        """Mine a block without transactions, stamped with the site's time."""
        self._mine(self.next_header(), [])

    def _next_timestamp(self) -> int:
        # Equal stamps are allowed, as in anvil and on L2s: with parent + 1 a burst of transactions would
        # push block time, and with it every deadline, ahead of the site's clock.
        now_s = self._now_s()
        return self._head.timestamp if now_s is None else max(self._head.timestamp, now_s)

    def _mine(self, header: BlockHeaderAPI, transactions: Sequence[SignedTransactionAPI]) -> None:
        try:
            self._chain.header = header
            for transaction in transactions:
                self._chain.apply_transaction(transaction)
            block = self._chain.mine_block(mix_hash=header.mix_hash, blob_gas_used=0)
            self._store.add_logs(_stored_logs(block, self.receipts(block)))
            self._store.commit()
        except BaseException:
            self._store.rollback()
            raise
        self._head = block.header

    def _decode(self, raw: bytes) -> SignedTransactionAPI:
        if raw[:1] == bytes([_BLOB_TRANSACTION]):
            raise TransactionRejected("blob transactions are not supported by this local chain")
        try:
            transaction = self._chain.get_transaction_builder().decode(raw)
            transaction.validate()
            transaction.get_sender()
        except Exception as error:
            # py-evm, rlp and eth_keys each raise their own types on hostile bytes; all mean the same here.
            raise TransactionRejected(f"invalid transaction encoding: {error!r:.200}") from error
        return transaction

    def _check(self, transaction: SignedTransactionAPI, header: BlockHeaderAPI) -> bool:
        """Whether its nonce is due. Raises refusals in geth's words, by which clients distinguish them."""
        if self._locate(transaction.hash) is not None:
            raise TransactionRejected("already known")
        if transaction.chain_id not in (self.chain_id, None):
            raise TransactionRejected(
                f"invalid sender: invalid chain id for signer: have {transaction.chain_id} "
                f"want {self.chain_id}"
            )
        state = self.state(self._head)
        nonce, expected = transaction.nonce, state.get_nonce(transaction.sender)
        if nonce < expected:
            raise TransactionRejected(f"nonce too low: next nonce {expected}, tx nonce {nonce}")
        if transaction.gas > header.gas_limit:
            raise TransactionRejected("exceeds block gas limit")
        if transaction.gas < transaction.intrinsic_gas:
            raise TransactionRejected(
                f"intrinsic gas too low: gas {transaction.gas}, minimum needed {transaction.intrinsic_gas}"
            )
        fee_cap = transaction.max_fee_per_gas
        if fee_cap < header.base_fee_per_gas:
            raise TransactionRejected(
                "max fee per gas less than block base fee: "
                f"maxFeePerGas: {fee_cap}, baseFee: {header.base_fee_per_gas}"
            )
        have, want = state.get_balance(transaction.sender), transaction.value + transaction.gas * fee_cap
        if have < want:
            raise TransactionRejected(f"insufficient funds for gas * price + value: have {have} want {want}")
        return nonce == expected


class _Computation(PragueComputation):
    """Notes whether the code looks at the gas that is left, but to pass it on with a call."""

    watches_gas = False


def _gas(computation: _Computation) -> None:
    following = computation.code.peek()
    computation.watches_gas = computation.watches_gas or following not in _CALLS
    computation.stack_push_int(computation.get_gas_remaining())


_Computation.opcodes = {
    **PragueComputation.opcodes,
    opcode_values.GAS: as_opcode(_gas, mnemonics.GAS, constants.GAS_BASE),
}

_CALLS = (opcode_values.CALL, opcode_values.STATICCALL, opcode_values.DELEGATECALL, opcode_values.CALLCODE)


def _watches_gas(computation: _Computation) -> bool:
    return computation.watches_gas or any(map(_watches_gas, computation.children))


def _depth(computation: ComputationAPI) -> int:
    """Calls within calls."""
    return max((1 + _depth(child) for child in computation.children), default=0)


class _LocalState(PragueState):
    computation_class = _Computation


class _LocalVM(PragueVM):
    """Prague without re-validating the blocks that this process has just made itself.

    py-evm's validation would forbid two blocks with the same timestamp, see `LocalChain._next_timestamp`.
    """

    _state_class = _LocalState

    def validate_block(self, block: BlockAPI) -> None:
        return None


def _chain_class(base: type[MiningChainAPI], chain_id: int) -> type[MiningChainAPI]:
    """eth-tester's chain with our id and rules."""
    members = {
        "chain_id": chain_id,
        "vm_configuration": ((0, _LocalVM),),
        "validate_block": lambda self, block: None,
    }
    return type("LocalChain", (base,), members)


def _signature(chain_id: int) -> bytes:
    """Start of the genesis block's extra data, by which a file of another chain is recognized."""
    return f"rodeo/{chain_id}/".encode()


def _raise_on_error(computation: ComputationAPI) -> None:
    if not computation.is_error:
        return
    if isinstance(computation.error, Revert):
        raise ExecutionReverted(computation.output)
    raise ExecutionFailed(f"{type(computation.error).__name__}: {computation.error}")


def _stored_logs(block: BlockAPI, receipts: Sequence[ReceiptAPI]) -> list[StoredLog]:
    logs: list[StoredLog] = []
    for index, receipt in enumerate(receipts):
        for entry in receipt.logs:
            logs.append(
                StoredLog(
                    block_number=block.number,
                    log_index=len(logs),
                    block_hash=block.hash,
                    block_timestamp=block.header.timestamp,
                    transaction_hash=block.transactions[index].hash,
                    transaction_index=index,
                    address=entry.address,
                    topics=tuple(topic.to_bytes(32, "big") for topic in entry.topics),
                    data=entry.data,
                )
            )
    return logs
