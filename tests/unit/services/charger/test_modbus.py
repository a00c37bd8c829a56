"""A dock's meter and contactor on Modbus, against pymodbus' own server on loopback."""

from __future__ import annotations

import os
import struct
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rodeo.errors import ConfigError
from rodeo.lab.config import DockConfig, MeterConfig
from rodeo.ros2.plain import deserialize, serialize
from rodeo.ros2.readings import power
from rodeo.site import topics
from rodeo_testing.modbus import METER, MODULE, Panel
from services.charger.lies import (
    CurrentWhileOpen,
    ImplausibleReading,
    MeterLie,
    RegisterFell,
    RegisterFrozen,
    RegisterOff,
    RegisterReset,
    WrongMeter,
)
from services.charger.modbus import MAPS, Line, MeterAway, ModbusTerminals, RegisterMap

NOW_NS = 1_900_000_000 * 10**9


class Bench:
    """The terminals of a dock on a panel, and a clock that the test moves."""

    def __init__(self, panel: Panel, **changes: Any) -> None:
        self.panel = panel
        self.time_ns = NOW_NS
        self.readings: list[Any] = []
        fields = {"source": "modbus", "address": panel.address, "unit": METER, "contactor_unit": MODULE}
        dock = DockConfig.model_validate({"pose": {"x_m": 1, "y_m": 1}, "meter": fields | changes})
        self.terminals = ModbusTerminals(dock, self._publish, lambda: self.time_ns)

    def _publish(self, message: Any, time_ns: int) -> None:
        assert time_ns == pytest.approx(self.time_ns, abs=1000)
        self.readings.append(deserialize(serialize(message), topics.DOCK_OUTPUT.type))

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.time_ns += 10**9
            self.panel.flow(1.0)
            self.terminals.read()

    def run_until_a_lie(self, seconds: int = 300) -> MeterLie:
        for _ in range(seconds):
            self.run(1)
            if self.terminals.lie is not None:
                return self.terminals.lie
        raise AssertionError("nothing was noticed")


@pytest.fixture
def fine(tmp_path: Path) -> str:
    """The map of a meter whose register resolves 1 Wh."""
    text = (MAPS / "sdm120.toml").read_text().replace("resolution_wh = 10.0", "resolution_wh = 2.0")
    (tmp_path / "fine.toml").write_text(text)
    return str(tmp_path / "fine.toml")


@contextmanager
def bench(panel: Panel | None = None, **changes: Any) -> Iterator[Bench]:
    with panel or Panel() as served:
        made = Bench(served, **changes)
        try:
            yield made
        finally:
            made.terminals.close()


@pytest.mark.parametrize(("model", "power_at"), [("sdm120", 12), ("sdm630", 52)])
def test_a_meters_power_reaches_the_record_as_current_at_the_contacts(model: str, power_at: int) -> None:
    with bench(Panel(power_at=power_at), model=model, efficiency=0.9) as one:
        assert one.terminals.silence
        assert one.terminals.command(True)
        one.run(2)
        said = power(one.readings[-1])
        assert said.voltage_v * said.current_a == pytest.approx(400 * 0.9, rel=1e-6)
        assert said.time_s == one.time_ns * 1e-9
        assert one.readings[-1].present
        assert not one.terminals.silence
        assert one.terminals.shown["meter_import_kwh"] == 57.093
        assert one.terminals.command(False)
        one.run(1)
        assert one.readings[-1].current == 0


def test_a_robot_that_leaves_the_contacts_is_not_present() -> None:
    with bench() as one:
        one.panel.present = False
        one.run(1)
        assert not one.readings[-1].present


@pytest.mark.parametrize("model", ["sdm120", "sdm630"])
def test_the_registers_are_those_of_eastrons_document(model: str) -> None:
    """30001 volts, 30073 import active energy; the power is that of the one phase, or of all."""
    found = RegisterMap.load(model)
    power_w = {"sdm120": 30013, "sdm630": 30053}[model]
    assert (found.voltage_v, found.power_w, found.import_kwh) == (30001, power_w, 30073)


def test_a_float_has_its_high_word_first() -> None:
    """Eastron's own example: 43 66 33 33 is 230.2 V."""
    with Panel() as panel:
        panel.voltage_v = struct.unpack(">f", bytes.fromhex("43663333"))[0]
        line = Line(panel.address, 9600, "N")
        assert line.measured(METER, 30001) == pytest.approx(230.2, abs=1e-4)
        line.close()


def test_a_register_map_of_ones_own_is_a_file(fine: str) -> None:
    own = Path(fine)
    own.write_text(own.read_text().replace("30013", "30053"))
    with bench(Panel(power_at=52), model=fine) as one:
        one.terminals.command(True)
        one.run(1)
        assert one.readings[-1].current > 0


@pytest.mark.parametrize("text", ["name = 1", "no toml at all", 'name = "x"\nvoltage_v = 1'])
def test_a_register_map_that_says_nothing_ends_the_start(tmp_path: Path, text: str) -> None:
    own = tmp_path / "own.toml"
    own.write_text(text)
    with pytest.raises(ConfigError) as found:
        RegisterMap.load(str(own))
    assert found.value.details["known"] == ["sdm120", "sdm630"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"source": "modbus"},
        {"address": "tcp://127.0.0.1:502"},
        {"source": "modbus", "address": "http://127.0.0.1"},
        {"source": "modbus", "address": "tcp://127.0.0.1:502", "contactor_unit": 1},
    ],
)
def test_a_meter_that_cannot_be_is_refused_with_the_site(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"meter|Modbus"):
        MeterConfig.model_validate(wrong)


# -- what lies -------------------------------------------------------------------------------------------


def test_a_unit_that_nobody_has_is_silence_and_hands_out_nothing() -> None:
    with bench(unit=9) as one:
        with pytest.raises(MeterAway, match="unit 9"):
            one.run(1)
        assert not one.readings
        assert one.terminals.silence


def test_another_meter_that_answers_is_noticed_and_believed_again_once_it_is_back() -> None:
    with bench(serial=20_260_117) as one:
        one.terminals.command(True)
        one.run(5)
        one.panel.serial += 1
        lie = one.run_until_a_lie()
        assert type(lie) is WrongMeter
        assert lie.details == {"serial": 20_260_118, "expected": 20_260_117}
        said = len(one.readings)
        one.panel.serial -= 1
        one.run(5)
        assert len(one.readings) == said
        one.run(10)
        assert one.terminals.lie is None
        assert len(one.readings) > said


def test_the_map_of_another_meter_is_noticed() -> None:
    """An SDM630's power is where an SDM120 has nothing: the register moves without it."""
    with bench(Panel(power_at=52), model="sdm120") as one:
        one.terminals.command(True)
        assert type(one.run_until_a_lie()) is RegisterOff


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"register_share": 0.0}, RegisterFrozen),
        ({"register_share": 0.8}, RegisterOff),
        ({"shown_w": 480.0}, RegisterOff),
        ({"import_wh": 57_000.0}, RegisterFell),
        ({"import_wh": 0.0}, RegisterReset),
        ({"voltage_v": 0.0}, ImplausibleReading),
        ({"shown_w": float("nan")}, ImplausibleReading),
    ],
)
def test_a_meter_that_contradicts_itself_is_named_and_hands_out_no_reading(
    fine: str, change: dict[str, float], kind: type[MeterLie]
) -> None:
    with bench(model=fine) as one:
        one.terminals.command(True)
        one.run(3)
        for name, value in change.items():
            setattr(one.panel, name, value)
        lie = one.run_until_a_lie()
        assert type(lie) is kind
        said = len(one.readings)
        one.run(5)
        assert len(one.readings) == said
        assert "is not believed" in one.terminals.silence
        assert not one.terminals.command(True), "current would flow that nobody can meter"
        assert one.terminals.command(False)


def test_a_register_that_lied_is_not_believed_again() -> None:
    with bench() as one:
        one.terminals.command(True)
        one.run(3)
        one.panel.import_wh -= 50
        assert type(one.run_until_a_lie()) is RegisterFell
        one.terminals.command(False)
        one.run(30)
        assert type(one.terminals.lie) is RegisterFell


def test_a_contactor_that_is_welded_is_noticed_until_nothing_flows() -> None:
    with bench() as one:
        one.terminals.command(True)
        one.run(5)
        one.panel.welded = True
        assert one.terminals.command(False), "its coil is off"
        assert type(one.run_until_a_lie(10)) is CurrentWhileOpen
        one.panel.welded = False
        one.run(15)
        assert one.terminals.lie is None


def test_a_coil_that_does_not_follow_is_no_confirmation() -> None:
    with bench() as one:
        one.panel.stuck = True
        assert not one.terminals.command(True)


def test_a_contactor_that_closed_unconfirmed_is_opened_once_it_answers() -> None:
    """Nobody would sell what flows, and the session may have ended by then."""
    with bench() as one:
        one.panel.mute = True
        assert not one.terminals.command(True)
        assert one.panel.coil
        one.panel.mute = False
        one.run(1)
        assert not one.panel.coil


def test_a_contactor_that_an_earlier_process_left_closed_is_opened() -> None:
    with bench() as one:
        one.panel.coil = True
        one.run(1)
        assert not one.panel.coil
        one.run(20)
        assert one.terminals.lie is None


def test_a_meter_that_was_unplugged_is_read_again_and_what_flowed_meanwhile_is_not_sold() -> None:
    with Panel() as panel:
        one = Bench(panel)
        one.terminals.command(True)
        one.run(3)
    with pytest.raises(MeterAway):
        one.run(1)
    assert not one.terminals.command(False)
    one.time_ns += 10 * 10**9
    again = Panel(port=panel.port)
    again.coil, again.import_wh = True, panel.import_wh + 1.0
    with again:
        one.panel = again
        one.terminals.command(True)
        one.run(30)
        assert one.terminals.lie is None
        assert one.readings[-1].current > 0
        one.terminals.close()


def test_answers_that_are_none_are_silence() -> None:
    """A converter that talks another protocol."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as listening:
        ended = threading.Event()

        def answer() -> None:
            connection, _ = listening.accept()
            with connection:
                while connection.recv(100):
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            ended.set()

        threading.Thread(target=answer, daemon=True).start()
        line = Line(f"tcp://127.0.0.1:{listening.getsockname()[1]}", 9600, "N")
        with pytest.raises(MeterAway):
            line.measured(METER, 30001)
        line.close()


# -- RTU -------------------------------------------------------------------------------------------------


@contextmanager
def serial_line() -> Iterator[tuple[str, str]]:
    """The two ends of a serial line, as devices."""
    (one, one_end), (other, other_end) = os.openpty(), os.openpty()
    tty.setraw(one_end)
    tty.setraw(other_end)

    def carry(source: int, target: int) -> None:
        try:
            while data := os.read(source, 1000):
                os.write(target, data)
        except OSError:
            return  # the line is taken down

    for ends in ((one, other), (other, one)):
        threading.Thread(target=carry, args=ends, daemon=True).start()
    try:
        yield os.ttyname(one_end), os.ttyname(other_end)
    finally:
        for end in (one_end, other_end, one, other):
            os.close(end)


def test_meter_and_contactor_share_a_serial_line() -> None:
    with serial_line() as (own, theirs), bench(Panel(serial_port=theirs), address=f"rtu://{own}") as one:
        assert one.terminals.command(True)
        one.run(3)
        assert one.readings[-1].current > 0
        one.panel.flows_w = 0.0
        one.run(1)
        assert one.readings[-1].current == 0
