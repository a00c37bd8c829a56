"""Tasks that real contracts settled with real proofs, in this process: the oracle says what a test wants."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from rodeo.bus.messages import Vote
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import TaskRequest
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.checks.report import Check, Outcome, Report
from rodeo.checks.rules import rules_hash
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.judging.votes import finding
from rodeo.kinds import kinds_of
from rodeo.money.currency import IEC
from rodeo.signing import keystores, possession, wallets
from rodeo.site.config import Site
from rodeo_kinds.battery_charging.harness.film import KIND, film_charging, register_after
from rodeo_testing.recordings import REGISTER_WH, ROBOT_RECEIPT, Sides, Take, Witnesses, seal
from tests.support.organization import CHAIN_ID, Clock, Organization, founded
from tests.support.site import LAB

APART_S = 3600
"""Site time between two charges."""
SOC_FROM = 0.94
"""From there on a charge takes some minutes."""
PRICE_IEC = Decimal(10)


class Said(NamedTuple):
    """What the oracle says of a task."""

    ruling: Outcome = "accepted"
    reason: str = "accepted"
    """{act} in it is the charge, {first} the first task that was posted for it."""
    is_reported: bool = True
    """Whether the chain has the hash of a report."""
    more: str = ""
    """What the report claims of the meter beside."""


OTHER_RULES = "0x" + "ab" * 32


@dataclass
class Settled:
    """An organization whose robot buys short charges, which are paid one after the other."""

    organization: Organization
    clock: Clock
    register_wh: float = REGISTER_WH
    act: str = ""
    """The newest charge, as reports list it."""
    turns: int = 0
    files: dict[int, Path] = field(default_factory=dict)
    """Task -> its proof in the store."""
    submitted: dict[int, Vote] = field(default_factory=dict)
    """Task -> the ruling on it."""

    def __post_init__(self) -> None:
        site, client = self.organization.site, self.organization.client
        self.store, self.rules = Store(site), rules_hash(kinds_of(site)[KIND]) or ""
        self.meter = wallets.load(site, f"{site.docks[0].name}-device")
        robot = wallets.load(site, "panther1-device")
        self.witnesses = Witnesses(charge=Sides(meter=self.meter, robot=robot))
        by, calls = self.organization.operator, client.organization_calls
        for _ in range(2):  # so that it may have two tasks at a time
            offer = calls.register_service(KIND, IEC.to_units(PRICE_IEC), 0, True, "")
            self.organization.send(by, offer)
        purse = IEC.to_units(40 * PRICE_IEC)
        self.organization.send(by, calls.transfer(self.organization.robot.address, purse))
        approved = client.calls.approve(client.task_manager, purse)
        self.organization.send(self.organization.robot, approved)

    def allow(self, rules: str) -> None:
        """Make other rules current, too."""
        client = self.organization.client
        judge = client.deployment.address("OracleJudge")
        allowed = client.organization_calls.allow_kind(KIND, judge, bytes.fromhex(rules[2:]))
        self.organization.send(self.organization.operator, allowed)

    def settle(
        self,
        *,
        rules: str | None = None,
        receipts: bool = True,
        named: str | None = None,
        said: Sequence[Said] = (Said(),),
    ) -> list[int]:
        """Numbers of tasks for which one charge is submitted: as many as are `said` something of. Without
        `receipts` the robot signed none of it. Executors submit `named` as their proofs' URI, if given;
        "{file}" in it is the file's name."""
        self.turns += 1
        film = film_charging(
            self.organization.site,
            soc=SOC_FROM,
            register_wh=self.register_wh,
            after_s=APART_S * self.turns,
        )
        began_wh, self.register_wh = self.register_wh, register_after(film)
        self.act = f"meter/{self.meter.address.lower()}/register/{began_wh:.4f}-{self.register_wh:.4f}"
        take = film if receipts else film.without(ROBOT_RECEIPT)
        self.clock.now_s = int(take.start_s) - 4
        assigned = [self._post(rules or self.rules) for _ in said]
        proofs = [self._seal(take, one) for one in assigned]
        self.clock.now_s = int(take.end_s) + 4
        for one, (sha256, uri), words in zip(assigned, proofs, said, strict=True):
            uri = (named or uri).replace("{file}", uri.rpartition("/")[2])
            self._submit(one, sha256, uri)
            reason = words.reason.format(act=self.act, first=assigned[0].task_id)
            self._rule(one, sha256, rules or self.rules, Said(words.ruling, reason, *words[2:]))
        return [one.task_id for one in assigned]

    def _post(self, rules: str) -> events.TaskAssigned:
        params = {"robot": "panther1", "dock": "dock1", "soc_from": SOC_FROM, "soc_target": 0.95}
        request = TaskRequest(
            KIND,
            IEC.to_units(PRICE_IEC),
            14_400,
            3600,
            1,
            bytes.fromhex(rules[2:]),
            0,
            ZERO_ADDRESS,
            json.dumps({"params": params | {"energy_wh": 5.0}, "description": ""}),
        )
        organization = self.organization
        posted = organization.events(organization.robot, organization.client.calls.register_task(request))
        return next(one for one in posted if isinstance(one, events.TaskAssigned))

    def _seal(self, take: Take, assigned: events.TaskAssigned) -> tuple[str, str]:
        """Hash and URI of the proof, which is in the store."""
        client = self.organization.client
        binding = Binding(
            chain_id=CHAIN_ID,
            task_manager=client.task_manager,
            organization=client.organization,
            device="dock1",
            task_id=assigned.task_id,
            attempt=assigned.attempt,
            executor=assigned.executor,
            nonce="0x" + assigned.nonce.hex(),
        )
        with tempfile.TemporaryDirectory() as folder:
            proof = seal(take, Path(folder, "proof.mcap"), binding, self.meter, self.witnesses)
            uri = self.store.put(proof.path)
        self.files[assigned.task_id] = Path(uri.removeprefix("file://"))
        return proof.sha256, uri

    def _submit(self, assigned: events.TaskAssigned, sha256: str, uri: str) -> None:
        calls = self.organization.client.organization_calls
        submitted = calls.submit_proof(assigned.task_id, assigned.attempt, bytes.fromhex(sha256[2:]), uri)
        self.organization.send(self.organization.operator, submitted)

    def _rule(self, assigned: events.TaskAssigned, sha256: str, rules: str, said: Said) -> None:
        """Whatever the proof shows: no oracle has looked at it."""
        organization = self.organization
        task_id, attempt = assigned.task_id, assigned.attempt
        report = Report.of(
            [Check(name="fetched", passed=True)],
            kind=KIND,
            task_id=task_id,
            attempt=attempt,
            acts=[self.act, *([f"meter/{self.meter.address.lower()}{said.more}"] if said.more else [])],
            rules_sha256=rules,
        )
        report_uri, report_sha256 = self.store.put_bytes(report.to_bytes(), ".json")
        vote = Vote(
            task_id=task_id,
            attempt=attempt,
            proof_sha256=sha256,
            report_sha256=report_sha256 if said.is_reported else "0x" + bytes(32).hex(),
            rules_sha256=rules,
            ruling=said.ruling,
            fault="nobody",
            amount_iec=PRICE_IEC if said.ruling == "accepted" else Decimal(0),
            reason=said.reason,
        )
        self.submitted[task_id] = vote
        judges = organization.client.judge_calls
        organization.send(organization.oracle, judges.oracle.rule(finding(vote, IEC), report_uri))

    def have_people_accept(self, task_id: int) -> None:
        """What the oracle passed on."""
        client, people = self.organization.client, self.organization.operator
        vote = self.submitted[task_id].model_copy(update={"ruling": "accepted", "amount_iec": PRICE_IEC})
        judge = client.deployment.address("OracleJudge")
        self.organization.send(people, client.judge_calls.auditor.rule_for(judge, finding(vote, IEC), ""))

    def sell_meter(self) -> None:
        """The meter gets another owner."""
        client, owner = self.organization.client, self.organization.robot.address
        registry, device = client.deployment.address("DeviceRegistry"), self.meter.address
        nonce = client.devices.nonce(device)
        signature = possession.sign(self.meter, owner, nonce, CHAIN_ID, registry)
        r, vs = bytes.fromhex(signature[2:66]), bytes.fromhex(signature[66:])
        site = self.organization.site
        role, name = keystores.device_names(site)[f"{site.docks[0].name}-device"]
        call = client.organization_calls.register_device(device, role, owner, name, r, vs)
        self.organization.send(self.organization.operator, call)

    def conclude(self, task_id: int) -> None:
        """Once nobody can rule on it any more."""
        self.clock.now_s += 30 * 24 * 3600
        self.organization.send(self.organization.robot, self.organization.client.calls.conclude(task_id))


@contextmanager
def settling(folder: Path, **changed: object) -> Iterator[Settled]:
    """An organization that has settled nothing yet; `changed` are settings of its site."""
    clock = Clock()
    wall = Site.load(LAB).clock.model_copy(update={"source": "wall"})
    with founded(folder, clock, clock=wall, **changed) as organization:
        yield Settled(organization, clock)
