"""What a site wants of its node, done on a node with each of the vices of `nodes.toml`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from deploy.chain.server import RpcServer
from rodeo.chain.client import connect
from rodeo.chain.deployment import Deployment
from rodeo.chain.node import rpc, transactions
from rodeo.chain.node.errors import ChainError, ContractReverted
from rodeo.site.config import Site
from services.bridge import orders, outcomes, signer
from services.bridge.chain import Chain
from services.bridge.readiness import Probe
from tests.outside.fake_node import FakeNode, Habits
from tests.outside.rows import Row
from tests.support.bridge_wallet import Robot
from tests.support.chain import CHAIN_ID, EmbeddedChain, FaultyNode
from tests.support.deployed import DeployedChain
from tests.support.site import write_site
from tests.support.snapshot import found, give_wallets

_STEPS = 240
_STEP_S = 0.25
"""A minute on the bridge's clock, which nobody waits for."""
CROWD = 24


class NotDone(AssertionError):
    """What had to work did not."""


@contextmanager
def a_chain(folder: Path) -> Iterator[DeployedChain]:
    """An organization on a chain that behaves."""
    site = Site.load(write_site(folder))
    give_wallets(site)
    found(site, folder / "chain.sqlite")
    node = FaultyNode(EmbeddedChain(folder / "chain.sqlite"))
    with RpcServer(site.chain.url, node):
        yield DeployedChain(site, node, Deployment.load(site.data_dir, CHAIN_ID))


def outcome(row: Row, chain: DeployedChain, folder: Path) -> str:
    """Empty where it works, else what is said."""
    folder.mkdir()
    with ExitStack() as stack:
        # Pauses between two tries are as short as they may be.
        for module, name in ((rpc, "BACKOFF_S"), (transactions, "PAUSE_S")):
            if hasattr(module, name):
                stack.enter_context(patch.object(module, name, 0.001))
        stack.enter_context(patch.object(outcomes, "REBROADCAST_S", 0.05))
        stack.enter_context(patch.object(outcomes, "FIRST_LOOK_S", 0.01))
        answer = chain.node.chain.methods
        node = stack.enter_context(
            FakeNode(lambda method, params: answer(method, params), Habits.model_validate(row.given))
        )
        changed = chain.site.chain.model_copy(update={"url": node.url})
        site = chain.site.model_copy(update={"chain": changed})
        try:
            DEEDS[row.how](Deed(DeployedChain(site, chain.node, chain.deployment), folder))
        except (ChainError, NotDone) as error:
            return f"{getattr(error, 'code', 'not_done')}: {error}"
    return ""


@dataclass
class Deed:
    """One site on the node, from its beginning."""

    chain: DeployedChain
    folder: Path

    @contextmanager
    def robot(self) -> Iterator[Robot]:
        robot = Robot(self.chain, self.folder)
        try:
            with ExitStack() as stack:
                for module in (orders, outcomes, signer):
                    clock = SimpleNamespace(monotonic=lambda: robot.wall_s)
                    stack.enter_context(patch.object(module, "time", clock))
                yield robot
        finally:
            robot.transactions.close()

    def until(self, robot: Robot, futures: list[Future[Any]]) -> None:
        """Step as the bridge's threads do, which continue after each error."""
        said: Exception | None = None
        for _ in range(_STEPS):
            if all(one.done() for one in futures):
                return
            for part in (robot.transactions.step, lambda: self.follow(robot), robot.transactions.step):
                try:
                    part()
                except ChainError as error:
                    said = error
            robot.wall_s += _STEP_S
        left = sum(not one.done() for one in futures)
        raise NotDone(f"{left} of {len(futures)} transactions are not done: {said}")

    def follow(self, robot: Robot) -> None:
        for _ in range(500):
            if not robot.follower.step([]):
                return
        raise NotDone("the index never is where the node is")

    def caught_up(self, robot: Robot) -> None:
        said: ChainError | None = None
        for _ in range(10):
            try:
                self.follow(robot)
            except ChainError as error:
                said = error
                continue
            if robot.follower.behind == 0 and robot.index.position.block >= 0:
                return
        raise NotDone(f"the index is empty: {said}")

    def problem(self, robot: Robot) -> str | None:
        probe = Probe(
            Chain(self.chain.deployment, robot.node, robot.index, robot.journal),
            {"panther1": robot.account.address},
            robot.transactions.outcomes,
        )
        return probe.problem()


def _bridge(deed: Deed, orders_at_once: int = 1) -> None:
    with deed.robot() as robot:
        deed.caught_up(robot)
        before = robot.index.position.block
        submit = robot.transactions.orders.submit
        futures = [submit(robot.order(number + 1, f"{number}")) for number in range(orders_at_once)]
        deed.until(robot, futures)
        blocks = [one.result()["block"] for one in futures]
        if min(blocks) <= before or robot.waiting():
            raise NotDone(f"mined in {blocks}, {robot.waiting()} are waiting")
        if problem := deed.problem(robot):
            raise NotDone(f"not ready: {problem}")


def _ready(deed: Deed) -> None:
    with deed.robot() as robot:
        with suppress(ChainError):
            deed.follow(robot)
        if problem := deed.problem(robot):
            raise NotDone(problem)


def _command_line(deed: Deed) -> None:
    deployment = deed.chain.deployment
    deployment.verify(connect(deed.chain.site.chain.url))
    client = deed.chain.client()
    if not list(client.history()):
        raise NotDone("no events")
    before, now_s = client.tasks.count(), client.time_s()
    with deed.robot() as robot:
        receipt = client.send(robot.account, client.calls.transfer(robot.oracle, 1), timeout_s=5.0)
    if receipt["status"] != 1 or client.tasks.count() != before or client.time_s() < now_s:
        raise NotDone("another outcome")


def _refusal(deed: Deed) -> None:
    client = deed.chain.client()
    with deed.robot() as robot:
        too_much = client.token.balance(robot.account.address) + 1
        deed.caught_up(robot)
        future = robot.transactions.orders.submit(robot.order(too_much))
        deed.until(robot, [future])
        errors = [future.exception()]
        try:
            client.send(robot.account, client.calls.transfer(robot.oracle, too_much), timeout_s=5.0)
        except ChainError as error:
            errors.append(error)
    for one in errors:
        if not isinstance(one, ContractReverted) or one.name != "ERC20InsufficientBalance":
            raise NotDone(f"instead of the contract's refusal: {one!r}")
    if len(errors) != 2:
        raise NotDone("it was not refused")


DEEDS: dict[str, Callable[[Deed], None]] = {
    "bridge": _bridge,
    "crowd": lambda deed: _bridge(deed, CROWD),
    "ready": _ready,
    "command line": _command_line,
    "refusal": _refusal,
}
