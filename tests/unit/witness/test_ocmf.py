"""What a dock's meter signs can be read and verified by other software: `pyocmf`, which is not ours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from pyocmf import OCMF

from rodeo.evidence.errors import BadStatement
from rodeo.signing import secp256k1
from rodeo.witness import ocmf
from rodeo.witness.statement import Head, MeterRecord
from rodeo_testing.assignments import METER, ROBOT
from tests.unit.services.charger.test_delivery import Bench


def public_key(key: bytes) -> str:
    """The public key of a private one, as hex of the usual DER, which is how a meter's buyer gets it."""
    point = b"\x04" + secp256k1.public_key(bytes(key))
    curve = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256K1(), point)
    return curve.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo).hex()


@pytest.fixture
def session(tmp_path: Path) -> Iterator[list[MeterRecord]]:
    """The records of a session in which the process began again, and which ended."""
    bench = Bench(tmp_path, register_wh=12_345.0)
    bench.run(200)
    bench.delivery.suspend()
    bench.start()
    bench.run(200)
    bench.delivery.close_session()
    yield bench.records
    bench.delivery.suspend()


def read(record: MeterRecord) -> OCMF:
    return OCMF.from_string(record.ocmf, strict=True)


def test_an_independent_reader_verifies_each_record_with_the_docks_public_key(
    session: list[MeterRecord],
) -> None:
    assert len(session) > 5
    assert all(read(record).verify_signature(public_key(METER.key)) for record in session)
    assert not any(read(record).verify_signature(public_key(ROBOT.key)) for record in session)


def test_it_reads_what_the_record_says(session: list[MeterRecord]) -> None:
    for record in session:
        payload = read(record).payload
        (reading,) = payload.RD
        assert (payload.FV, payload.GS, payload.MS, payload.ID) == ("1.2", "dock1", "dock1", "panther1")
        assert float(reading.RV) == record.register_wh
        assert reading.timestamp.timestamp() == pytest.approx(record.until_s, abs=1e-3)
        assert (str(reading.RU), str(reading.time_status)) == ("Wh", "S")
    assert [str(read(one).payload.RD[0].TX) for one in (session[0], session[1], session[-1])] == [
        "B",
        "C",
        "E",
    ]


def test_the_pagination_has_no_gap_also_over_a_restart(session: list[MeterRecord]) -> None:
    assert [read(record).payload.PG for record in session] == [f"T{1 + n}" for n in range(len(session))]


def test_begin_and_end_of_a_session_are_a_lawful_transaction(session: list[MeterRecord]) -> None:
    begin, end = read(session[0]), read(session[-1])
    assert begin.check_eichrecht(end, errors_only=True) == []


def test_the_extension_binds_a_record_to_its_task_and_to_its_chain(session: list[MeterRecord]) -> None:
    record = session[3]
    extension = (read(record).payload.model_extra or {})[ocmf.EXTENSION]
    assert extension["recording"] == record.recording
    assert (extension["task_id"], extension["attempt"]) == (record.task_id, record.attempt)
    assert extension["previous"] == record.previous
    assert extension["page"] == record.page


def test_a_changed_digit_is_refused(session: list[MeterRecord]) -> None:
    record = session[3]
    said = f'"RV":{record.register_wh}'
    assert said in record.ocmf
    more = record.ocmf.replace(said, f'"RV":{record.register_wh + 1}')
    assert not OCMF.from_string(more).verify_signature(public_key(METER.key))
    with pytest.raises(BadStatement, match="does not match"):
        ocmf.check(record.model_copy(update={"ocmf": more}), METER.address)


@pytest.mark.long
@pytest.mark.parametrize(
    "change", [{"register_wh": 1.0}, {"page": 99}, {"until_s": 1.0}, {"seq": 99}, {"robot": "panther2"}]
)
def test_a_record_that_says_otherwise_than_its_text_is_refused(
    session: list[MeterRecord], change: dict[str, object]
) -> None:
    ocmf.check(session[3], METER.address)
    with pytest.raises(BadStatement, match="does not match"):
        ocmf.check(session[3].model_copy(update=change), METER.address)


def test_only_the_docks_own_signature_counts(session: list[MeterRecord]) -> None:
    record = session[3]
    for text in (
        ocmf.sign(ocmf.data(record), bytes(ROBOT.key)),
        f"OCMF|{ocmf.data(record)}|" + "[" * 5000,
        f'OCMF|{ocmf.data(record)}|{{"SA":"{ocmf.ALGORITHM}","SE":"hex","SD":"00"}}',
        f"OCMF|{ocmf.data(record)}|[]",
    ):
        with pytest.raises(BadStatement, match="not signed"):
            ocmf.check(record.model_copy(update={"ocmf": text}), METER.address)


def test_a_name_with_the_formats_separator_and_a_full_list_of_heads_fit(session: list[MeterRecord]) -> None:
    digest = "0x" + "ab" * 32
    head = Head(device="bin", address=METER.address, chain=digest, index=10**9, digest=digest)
    odd = session[3].model_copy(update={"robot": "a|" * 32, "device": "b|" * 32, "heads": (head,) * 64})
    said = odd.model_dump() | {"ocmf": ocmf.sign(ocmf.data(odd), bytes(METER.key))}
    record = MeterRecord.model_validate(said)
    ocmf.check(record, METER.address)
    assert read(record).payload.ID == "a|" * 32


def test_a_time_that_no_calendar_has_is_refused(session: list[MeterRecord]) -> None:
    with pytest.raises(BadStatement, match="time"):
        ocmf.check(session[3].model_copy(update={"until_s": 1e300}), METER.address)
