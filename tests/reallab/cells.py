"""The bin's load cells and range sensor on an amplifier with Modbus TCP, served by pymodbus' own server."""

from __future__ import annotations

import asyncio
import struct
import threading
from collections.abc import Callable
from typing import Any

from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

UNIT = 1
_REGISTERS = 100


class Cells:
    """Floats in input registers from address 0: the range in m, then the weight in N of each compartment.

    Args:
        values: what the sensors show now.
    """

    def __init__(self, port: int, values: Callable[[], list[float]]) -> None:
        self._port, self._values = port, values
        self.frozen = False
        """Whether the weights are those of before."""
        self.share = 1.0
        """How much of the weights it shows."""
        self._shown_n: list[float] = []
        bits = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
        words = [SimData(0, count=_REGISTERS, datatype=DataType.REGISTERS)]
        device = SimDevice(UNIT, simdata=(list(bits), list(bits), list(words), words), action=self._answer)
        self._device = device
        threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True).start()

    async def _serve(self) -> None:
        await ModbusTcpServer([self._device], address=("127.0.0.1", self._port)).serve_forever()

    async def _answer(
        self, _function: int, start: int, address: int, count: int, registers: list[int], _values: Any
    ) -> None:
        range_m, *weights_n = self._values()
        if not self.frozen or not self._shown_n:
            self._shown_n = [self.share * one for one in weights_n]
        said = b"".join(struct.pack(">f", value) for value in (range_m, *self._shown_n))
        words = struct.unpack(f">{len(said) // 2}H", said)
        registers[: len(words)] = words
