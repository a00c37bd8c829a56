"""A dock's meter and contactor on Modbus, TCP or RTU.

The meter's registers are data (`meters/`). The contactor is a coil of an input and output module, and one of
the module's inputs says whether a robot is on the contacts. A meter on the mains side of the supply shows
neither voltage nor current at the contacts: what the dock reports there is the power that it shows, less the
supply's losses, at the dock's own voltage.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from rodeo.errors import ConfigError, RodeoError, unreadable
from rodeo.host.stamps import sec_nanosec
from rodeo.lab.config import DockConfig, MeterConfig
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.plain import Message, PlainNode, new, serialize
from rodeo.site import topics
from services.charger.lies import MeterLie, RegisterLie, Shown, Watch, WrongMeter

log = logging.getLogger(__name__)
# It logs each lost request; `MeterAway` reports them once.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

PERIOD_S = 1.0
"""Wall time from one reading to the next, as the table of keys has it."""
_TIMEOUT_S = 1.0
_SILENCE_S = 10.0
"""Wall time without a reading after which the meter counts as missing."""
_BELIEVED_AGAIN = 10
"""Readings in a row without a contradiction after which one that can be refuted is over."""
_FIRST_REGISTER = 30001
"""Number of the input register with address 0."""
_PORT = 502
MAPS = Path(__file__).parent / "meters"


class MeterAway(RodeoError):
    """Meter or contactor does not answer."""


class RegisterMap(BaseModel):
    """Where a model of meters has what; input registers by number, each a float in two registers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str
    voltage_v: int = Field(ge=_FIRST_REGISTER, lt=40000)
    power_w: int = Field(ge=_FIRST_REGISTER, lt=40000)
    import_kwh: int = Field(ge=_FIRST_REGISTER, lt=40000)
    serial: int | None = Field(None, ge=0, lt=65535)
    """Address of the holding register with the serial number, an unsigned integer in two registers."""
    resolution_wh: float = Field(gt=0)
    volts: tuple[float, float]

    @classmethod
    def load(cls, model: str) -> Self:
        """The map of this name, or in this file. Raises ConfigError."""
        path = Path(model) if model.endswith(".toml") else MAPS / f"{model}.toml"
        try:
            return cls.model_validate(tomllib.loads(path.read_text()))
        except (OSError, ValueError, ValidationError) as error:
            raise ConfigError(
                f"no registers of a meter can be read: {unreadable(error)}",
                model=model,
                known=sorted(one.stem for one in MAPS.glob("*.toml")),
            ) from error


class Line:
    """One connection of Modbus, which meter and contactor may share. Thread-safe; every method raises
    MeterAway."""

    def __init__(self, address: str, baud: int, parity: str) -> None:
        self._address = address
        self._lock = threading.Lock()
        parts = urlsplit(address)
        options: dict[str, Any] = {"timeout": _TIMEOUT_S, "retries": 1}
        self._client: ModbusTcpClient | ModbusSerialClient
        if parts.scheme == "rtu":
            self._client = ModbusSerialClient(parts.path, baudrate=baud, parity=parity, **options)
        else:
            framer = FramerType.RTU if parts.scheme == "rtu+tcp" else FramerType.SOCKET
            port = parts.port or _PORT
            self._client = ModbusTcpClient(str(parts.hostname), port=port, framer=framer, **options)

    def measured(self, unit: int, register: int) -> float:
        """The float in an input register."""
        address = register - _FIRST_REGISTER
        read = partial(self._client.read_input_registers, address, count=2, device_id=unit)
        return float(self._ask(unit, read, lambda answer: _FLOAT.unpack(_words(answer))[0]))

    def number(self, unit: int, address: int) -> int:
        """The unsigned integer in a holding register."""
        read = partial(self._client.read_holding_registers, address, count=2, device_id=unit)
        return int(self._ask(unit, read, lambda answer: _INTEGER.unpack(_words(answer))[0]))

    def coil(self, unit: int, number: int) -> bool:
        read = partial(self._client.read_coils, number, count=1, device_id=unit)
        return bool(self._ask(unit, read, lambda answer: answer.bits[0]))

    def set_coil(self, unit: int, number: int, value: bool) -> None:
        self._ask(unit, partial(self._client.write_coil, number, value, device_id=unit), lambda _answer: None)

    def input(self, unit: int, number: int) -> bool:
        read = partial(self._client.read_discrete_inputs, number, count=1, device_id=unit)
        return bool(self._ask(unit, read, lambda answer: answer.bits[0]))

    def _ask(self, unit: int, request: Callable[[], Any], value: Callable[[Any], Any]) -> Any:
        with self._lock:
            try:
                answer = request()
                if answer.isError():
                    raise MeterAway(f"unit {unit} on {self._address} refuses: {answer}")
                return value(answer)
            except _FAILED as error:
                # The answer to this request must not be taken for that to the next.
                self._client.close()
                raise MeterAway(f"unit {unit} on {self._address} does not answer: {error}") from error

    def close(self) -> None:
        with self._lock:
            self._client.close()


_FAILED = (ModbusException, OSError, ValueError, AttributeError, IndexError, TypeError, struct.error)
"""Errors that pymodbus raises for lost connections and for invalid answers."""
_FLOAT, _INTEGER, _WORDS = struct.Struct(">f"), struct.Struct(">I"), struct.Struct(">HH")


def _words(answer: Any) -> bytes:
    return _WORDS.pack(*answer.registers)


class Devices:
    """A dock's meter and its contactor's module. Every method raises MeterAway."""

    def __init__(self, config: MeterConfig) -> None:
        self._config = config
        self.map = RegisterMap.load(config.model)
        self._meter = Line(config.address, config.baud, config.parity)
        apart = config.contactor_address not in ("", config.address)
        self._module = Line(config.contactor_address, config.baud, config.parity) if apart else self._meter

    def present(self) -> bool:
        """Whether a robot is on the contacts."""
        return self._module.input(self._config.contactor_unit, self._config.present)

    def closed(self) -> bool:
        """How the contactor's coil stands."""
        return self._module.coil(self._config.contactor_unit, self._config.coil)

    def move(self, closed: bool) -> bool:
        """Close or open the contactor; how its coil stands then."""
        self._module.set_coil(self._config.contactor_unit, self._config.coil, closed)
        return self.closed()

    def shown(self, now_ns: Callable[[], int]) -> Shown:
        """What the meter shows. Raises WrongMeter, too."""
        unit, expected = self._config.unit, self._config.serial
        if expected is not None and self.map.serial is not None:
            serial = self._meter.number(unit, self.map.serial)
            if serial != expected:
                raise WrongMeter("another meter answers", serial=serial, expected=expected)
        # The power comes last: its moment is the reading's.
        import_wh = self._meter.measured(unit, self.map.import_kwh) * 1000
        voltage_v = self._meter.measured(unit, self.map.voltage_v)
        power_w = self._meter.measured(unit, self.map.power_w)
        return Shown(now_ns() * 1e-9, voltage_v, power_w, import_wh)

    def close(self) -> None:
        for line in {self._meter, self._module}:
            line.close()


class ModbusTerminals:
    """The terminals of a dock on Modbus: read once a second in a thread of their own, and published.

    Args:
        publish: gets each reading at the contacts; nothing is handed out that contradicts itself.
        now_ns: site time.
    """

    def __init__(
        self, dock: DockConfig, publish: Callable[[Message, int], None], now_ns: Callable[[], int]
    ) -> None:
        self._dock, self._publish, self._now_ns = dock, publish, now_ns
        self._devices = Devices(dock.meter)
        most_w = dock.voltage_v * dock.current_a / dock.meter.efficiency
        idle_w = dock.voltage_v * dock.cutoff_a / 2
        self._watch = Watch(self._devices.map.volts, self._devices.map.resolution_wh, idle_w, most_w)
        self._closed = False
        """Whether the contactor was commanded to close, and did."""
        self._lock = threading.Lock()
        """Held while the contactor is moved, and from a reading to its comparison."""
        self._shown: Shown | None = None
        self._lie: MeterLie | None = None
        self._truths = 0
        """Readings since the last contradiction."""
        self._away = "it was not read yet"
        self._read_s = -math.inf
        """Wall (monotonic) time of the last reading."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{dock.name} meter", daemon=True)

    @classmethod
    def of(cls, dock: DockConfig, node: PlainNode, on_reading: Callable[[Any, MessageInfo], None]) -> Self:
        """The terminals of `dock`, which `node` publishes and `on_reading` gets."""
        output = topics.DOCK_OUTPUT
        publisher = node.publisher(output.name(dock=dock.name), output.type)

        def publish(message: Message, time_ns: int) -> None:
            cdr = serialize(message)
            sequence = publisher.publish_cdr(cdr, time_ns)
            # What another process said in the name of this topic does not come here.
            on_reading(message, MessageInfo(cdr, time_ns, sequence, publisher.gid))

        terminals = cls(dock, publish, node.clock.now_ns)
        terminals.start()
        return terminals

    def start(self) -> None:
        self._thread.start()

    @property
    def silence(self) -> str:
        if self._lie is not None:
            return f"the meter of {self._dock.name} is not believed: {self._lie}"
        if time.monotonic() - self._read_s <= _SILENCE_S:
            return ""
        return f"no readings from the meter of {self._dock.name}: {self._away}"

    @property
    def lie(self) -> MeterLie | None:
        return self._lie

    @property
    def shown(self) -> dict[str, Any]:
        shown = self._shown
        if shown is None:
            return {}
        return {
            "meter": self._devices.map.name,
            "meter_power_w": round(shown.power_w, 1),
            "meter_import_kwh": round(shown.import_wh / 1000, 3),
        }

    @property
    def least_order_wh(self) -> float:
        return self._watch.least_order_wh

    def command(self, closed: bool) -> bool:
        if closed and self._lie is not None:
            return False
        with self._lock:
            # Until the coil confirms that it closed: else nobody would open what closed unconfirmed.
            self._closed = False
            try:
                stands = self._devices.move(closed)
            except MeterAway as error:
                log.warning("the contactor of %s: %s", self._dock.name, error)
                return False
            self._closed = closed and stands
            self._watch.contactor(self._closed, self._now_ns() * 1e-9)
        if stands is not closed:
            log.warning("the contactor of %s did not %s", self._dock.name, "close" if closed else "open")
        return stands is closed

    def read(self) -> None:
        """Read meter and contactor once. Raises MeterAway."""
        try:
            with self._lock:
                present, shown = self._look()
        except MeterLie as lie:
            self._disbelieve(lie)
            return
        self._shown, self._read_s, self._away = shown, time.monotonic(), ""
        self._truths += 1
        if self._truths >= _BELIEVED_AGAIN and not isinstance(self._lie, RegisterLie):
            self._lie = None
        if self._lie is None:
            time_ns = round(shown.time_s * 1e9)
            self._publish(self._reading(shown, present, time_ns), time_ns)

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._devices.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            begun_s = time.monotonic()
            try:
                self.read()
            except MeterAway as error:
                if not self._away:
                    log.warning("the meter of %s: %s", self._dock.name, error)
                self._away = str(error)
            self._stop.wait(max(0.0, begun_s + PERIOD_S - time.monotonic()))

    def _look(self) -> tuple[bool, Shown]:
        """Whether a robot is there, and what the meter shows. Raises MeterAway, MeterLie."""
        present = self._devices.present()
        if self._devices.closed() and not self._closed:
            # An earlier process left it closed, or somebody else closed it.
            log.warning("the contactor of %s is closed and should not be: opening it", self._dock.name)
            self._devices.move(False)
        shown = self._devices.shown(self._now_ns)
        self._watch.see(shown)
        return present, shown

    def _disbelieve(self, lie: MeterLie) -> None:
        self._truths = 0
        self._read_s, self._away = time.monotonic(), ""
        if not isinstance(self._lie, RegisterLie):
            if type(lie) is not type(self._lie):
                log.error("the meter of %s: %s", self._dock.name, lie)
            self._lie = lie

    def _reading(self, shown: Shown, present: bool, time_ns: int) -> Message:
        """What flows at the contacts."""
        power_w = max(shown.power_w, 0.0) * self._dock.meter.efficiency
        stamp = new(
            "builtin_interfaces/msg/Time", **dict(zip(("sec", "nanosec"), sec_nanosec(time_ns), strict=True))
        )
        nan = math.nan
        return new(
            topics.DOCK_OUTPUT.type,
            header=new("std_msgs/msg/Header", stamp=stamp, frame_id=self._dock.name),
            voltage=self._dock.voltage_v,
            current=power_w / self._dock.voltage_v,
            **dict.fromkeys(("temperature", "charge", "capacity", "design_capacity", "percentage"), nan),
            power_supply_status=1 if power_w else 3,
            present=present,
            location=self._devices.map.name,
            serial_number=str(self._dock.meter.serial or ""),
        )
