"""A meter and a contactor's module on Modbus, served by pymodbus' own server on loopback."""

from __future__ import annotations

import asyncio
import struct
import threading
from typing import Any, Self

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from rodeo_testing.waiting import HANG_S

METER, MODULE = 1, 2
"""Units."""
_SERIAL = 0xFC00
_REGISTERS = 400
_READ_INPUTS, _READ_HOLDING, _READ_REGISTERS = 2, 3, 4
"""Function codes."""


class Panel:
    """An Eastron meter before a supply of `flows_w`, and a module with the contactor's coil.

    Attributes are what a test sets: `welded` contacts conduct although the coil is off, a `stuck` coil does
    not follow, and a `mute` one does, but nobody can ask how it stands.

    Args:
        port: of loopback, 0 for a free one.
        serial_port: a device in the place of TCP.
        power_at: address of the input register of the power.
    """

    def __init__(self, port: int = 0, serial_port: str = "", power_at: int = 12) -> None:
        self.flows_w = 400.0
        self.voltage_v = 230.2
        self.import_wh = 57_093.0
        self.serial = 20_260_117
        self.present = True
        self.coil = False
        self.welded = self.stuck = self.mute = False
        self.register_share = 1.0
        """Share of what flows that the register counts."""
        self.shown_w: float | None = None
        """The power that the meter shows, where it lies."""
        self._power_at = power_at
        self._serving = _Serving(self._devices(), port, serial_port)

    @property
    def port(self) -> int:
        return self._serving.port

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    @property
    def power_w(self) -> float:
        """What flows."""
        return self.flows_w if self.coil or self.welded else 0.0

    def flow(self, seconds: float) -> None:
        """Let time pass."""
        self.import_wh += self.power_w * seconds / 3600 * self.register_share

    def __enter__(self) -> Self:
        self._serving.start()
        return self

    def __exit__(self, *_raised: object) -> None:
        self._serving.stop()

    def _devices(self) -> list[SimDevice]:
        bits = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
        none = [SimData(0, count=2, datatype=DataType.REGISTERS)]
        serial = [SimData(_SERIAL, count=2, datatype=DataType.REGISTERS)]
        inputs = [SimData(0, count=_REGISTERS, datatype=DataType.REGISTERS)]
        return [
            SimDevice(METER, simdata=(list(bits), list(bits), serial, inputs), action=self._on_meter),
            SimDevice(MODULE, simdata=(list(bits), list(bits), none, list(none)), action=self._on_module),
        ]

    async def _on_meter(
        self, function: int, _start: int, _address: int, _count: int, registers: list[int], _values: Any
    ) -> ExcCodes | None:
        if function == _READ_HOLDING:
            registers[:2] = divmod(self.serial, 2**16)
        elif function == _READ_REGISTERS:
            shown_w = self.power_w if self.shown_w is None else self.shown_w
            values = {0: self.voltage_v, self._power_at: shown_w, 72: self.import_wh / 1000}
            for at, value in values.items():
                registers[at : at + 2] = struct.unpack(">HH", struct.pack(">f", value))
        return None

    async def _on_module(
        self, function: int, _start: int, _address: int, _count: int, registers: list[int], values: Any
    ) -> ExcCodes | None:
        if values is not None:
            self.coil = self.coil if self.stuck else bool(values[0])
            values[0] = self.coil
        elif function == _READ_INPUTS:
            registers[0] = int(self.present)
        elif self.mute:
            return ExcCodes.DEVICE_BUSY
        else:
            registers[0] = int(self.coil)
        return None


class _Serving:
    """A server in a thread of its own."""

    def __init__(self, devices: list[SimDevice], port: int, serial_port: str) -> None:
        self.port = port
        self._devices, self._serial_port = devices, serial_port
        self._up = threading.Event()
        self._loop: asyncio.AbstractEventLoop
        self._server: Any
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)

    def start(self) -> None:
        self._thread.start()
        if not self._up.wait(HANG_S):
            raise TimeoutError("the panel does not listen")

    def stop(self) -> None:
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(HANG_S)
        self._thread.join()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        if self._serial_port:
            self._server = ModbusSerialServer(
                self._devices, port=self._serial_port, baudrate=9600, parity="N"
            )
        else:
            self._server = ModbusTcpServer(self._devices, address=("127.0.0.1", self.port))
        await self._server.serve_forever(background=True)
        if not self._serial_port:
            self.port = self._server.transport.sockets[0].getsockname()[1]
        self._up.set()
        await self._server.serving
