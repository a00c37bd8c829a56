"""Statements stand in the logs of their days that are on chain, or people decide."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.bus.messages import Device, Root
from rodeo.checks.case import ChainRecord
from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from rodeo.witness.days import DayLog, day_of
from rodeo.witness.statement import digest
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_kinds.waste_disposal.harness.hearsay import of_a_meter
from rodeo_testing.assignments import BIN, BINDING, METER, MOCAP, ORGANIZATION, ROBOT
from rodeo_testing.recordings import Take, Witnesses, seal
from services.oracle.chain_view import as_of
from tests.unit.conftest import Judge, finding

pytestmark = pytest.mark.long

STRANGER = Account.create()


@pytest.fixture(scope="module")
def said(cleaning: Take, tmp_path_factory: pytest.TempPathFactory) -> list[Attestation]:
    """What motion capture and bin sign while the cleaning is filmed: the same each time."""
    heard: list[Attestation] = []

    def hear(attestation: Attestation) -> Attestation:
        heard.append(attestation)
        return attestation

    seal(cleaning, tmp_path_factory.mktemp("said") / "proof.mcap", BINDING, ROBOT, Witnesses(edit=hear))
    return heard


@pytest.fixture
def stored(site: Site, tmp_path: Path) -> Site:
    return site.model_copy(update={"data_dir": tmp_path})


def root(
    site: Site,
    said: Sequence[Attestation],
    account: LocalAccount,
    *,
    signer: LocalAccount | None = None,
    without: int | None = None,
    block: int = 1,
) -> Root:
    """The root of what a device signed, with another digest in place of number `without`, from 0."""
    own = [one for one in said if one.signer == account.address]
    digests = [digest(one) for one in own]
    if without is not None:
        digests[without] = "0x" + "ab" * 32
    first = own[0].payload
    log = DayLog(
        chain_id=first["chain_id"],
        task_manager=first["task_manager"],
        organization=first["organization"],
        device=first["device"],
        address=account.address,
        day=day_of(first["time_s"]),
        first=first["seq"],
        statements=tuple(digests),
    )
    signed = attest(log.model_dump(mode="json"), signer or account)
    uri, sha256 = Store(site).put_bytes(signed.model_dump_json().encode(), ".json")
    return Root(device=account.address, day=log.day, root=sha256, uri=uri, block=block)


def with_roots(chain: ChainRecord, *roots: Root) -> ChainRecord:
    return chain.model_copy(update={"roots": list(roots)})


def test_statements_that_stand_in_their_logs_are_counted(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, said, MOCAP), root(stored, said, BIN))
    report = judge(cleaning, chain, at=stored)
    assert report.accepted, report.reason
    witnesses = [one for one in said if one.signer in (MOCAP.address, BIN.address)]
    assert finding(report, "in_daily_log").measured == len(witnesses)


@pytest.mark.parametrize(("account", "whose"), [(MOCAP, "the mocap mocap"), (BIN, "the bin itrash")])
def test_a_statement_that_is_not_in_its_devices_own_log_leaves_it_to_people(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site, account: LocalAccount, whose: str
) -> None:
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, said, account, without=1))
    report = judge(cleaning, chain, at=stored)
    assert (report.outcome, report.fault) == ("undecided", whose)
    assert report.reason.startswith("in_daily_log: 1 statements of")


def test_a_log_that_its_device_did_not_sign_says_nothing(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    """An operator may post a root for any device."""
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, said, BIN, signer=STRANGER, without=1))
    report = judge(cleaning, chain, at=stored)
    assert report.accepted, report.reason
    assert "the log belongs to another device" in finding(report, "in_daily_log").detail


def test_what_a_device_without_a_part_in_the_case_denies_is_not_asked(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    """A bystander's meter posts a root that lacks what it signed itself while the item was carried."""
    take = of_a_meter(cleaning)
    own = [Attestation.model_validate(one.message) for one in take.of("rodeo/attestation")]
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, own, METER, without=0))
    report = judge(take, chain, at=stored)
    assert report.accepted, report.reason


def test_a_log_that_is_gone_says_nothing(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    posted = root(stored, said, BIN, without=1)
    gone = posted.model_copy(update={"uri": f"{stored.store_url}/{'ab' * 32}.json"})
    report = judge(cleaning, with_roots(cleaning_chain_record(cleaning), gone), at=stored)
    assert report.accepted, report.reason


def test_a_log_that_a_successor_signed_counts(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, said, BIN, signer=STRANGER, without=1))
    successor = Device(address=STRANGER.address, role="bin", name="itrash", owner=ORGANIZATION)
    chain = chain.model_copy(update={"devices": [*chain.devices, successor]})
    assert judge(cleaning, chain, at=stored).outcome == "undecided"


def test_what_came_after_a_verdict_is_not_part_of_it(
    cleaning: Take, said: list[Attestation], judge: Judge, stored: Site
) -> None:
    """Keys are compared by block: two blocks may have one time."""
    chain = with_roots(cleaning_chain_record(cleaning), root(stored, said, BIN, without=1, block=12))
    submitted_s = chain.task.proof_submitted
    taken = {"revoked": submitted_s, "revoked_because": "compromised"}
    devices = [one.model_copy(update=taken) if one.role == "mocap" else one for one in chain.devices]
    newcomer = Device(address=STRANGER.address, role="mocap", name="mocap", owner=ORGANIZATION)
    chain = chain.model_copy(update={"devices": [*devices, newcomer]})
    blocks: dict[str, tuple[float, float]] = {one.address.lower(): (1, 11) for one in chain.devices}
    blocks[STRANGER.address.lower()] = (12, 99)

    then = as_of(chain, 10, blocks)
    assert judge(cleaning, then.chain_record, at=stored).accepted
    assert [one.role for one in then.revoked] == ["mocap"]
    assert [one.block for one in then.roots] == [12]
    assert STRANGER.address not in [one.address for one in then.chain_record.devices]

    at_last = as_of(chain, 12, blocks)
    assert judge(cleaning, at_last.chain_record, at=stored).outcome == "undecided"
    assert (at_last.revoked, at_last.roots) == ([], [])
