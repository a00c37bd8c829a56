"""The lab's bin: that of examples/my_bin.py, with its sensors wired to its computer instead of on the bus.

LAB_CELLS is the port of the load cells' amplifier (Modbus TCP), LAB_CAMERA the address of the camera (MJPEG).
"""

from __future__ import annotations

import os
import struct
import sys
import threading
import urllib.request
from functools import partial
from types import SimpleNamespace
from typing import Any

from my_bin import MyBin, names, run
from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient

from rodeo.runtime.process import main_of_one
from rodeo.site.names import bin_process

PERIOD_S = 0.1
_CELLS_UNIT = 1
_PATIENCE_S = 5.0
_FROZEN_S = 3.0
"""No two pictures of a real sensor are equal."""


class Camera:
    """The newest picture of a stream, and when it came. A stream that breaks off is opened again."""

    def __init__(self, address: str, now_s: Any) -> None:
        self._address, self._now_s = address, now_s
        self._taken: tuple[float, bytes] | None = None
        self._last = b""
        self._heard_s = self._changed_s = now_s()
        self._came = threading.Condition()
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def problem(self) -> str:
        """Why what it shows is not what is in front of it."""
        if self._now_s() - self._heard_s > _PATIENCE_S:
            return f"pictures from the camera {self._address}"
        if self._now_s() - self._changed_s > _FROZEN_S:
            return f"the camera {self._address}, which shows the same picture again and again"
        return ""

    def picture(self) -> tuple[float, bytes] | None:
        """One that comes from now on; None if none comes in time."""
        with self._came:
            self._taken = None
            self._came.wait_for(lambda: self._taken, _PATIENCE_S)
            return self._taken

    def _run(self) -> None:
        pause = threading.Event()
        while not pause.wait(0.5):
            try:
                with urllib.request.urlopen(self._address, timeout=_PATIENCE_S) as stream:
                    self._read(stream)
            except OSError as error:
                print(f"no pictures: {error}", flush=True)

    def _read(self, stream: Any) -> None:
        size = 0
        while line := stream.readline():
            if line.lower().startswith(b"content-length:"):
                size = int(line.split(b":")[1])
            elif size and not line.strip():
                data, size = stream.read(size), 0
                self._heard_s = self._now_s()
                if data != self._last:
                    self._last, self._changed_s = data, self._heard_s
                with self._came:
                    self._taken = self._now_s(), data
                    self._came.notify_all()


class LabBin(MyBin):
    inputs = "sensor"

    def open_sensors(self) -> None:
        self.trigger = self
        self._camera = Camera(os.environ["LAB_CAMERA"], self.process.clock.now_s)
        self._cells = ModbusTcpClient("127.0.0.1", port=int(os.environ["LAB_CELLS"]), timeout=1, retries=0)
        threading.Thread(target=self._measure, daemon=True).start()

    def missing(self) -> str:
        return super().missing() or self._camera.problem

    def call(self, _request: Any, timeout_s: float) -> None:
        """Take a picture of what is shown."""
        if (taken := self._camera.picture()) is None:
            self.looked = False
            self.view.clear()
            return
        time_s, data = taken
        self.todo.put(partial(self.pictured, SimpleNamespace(data=memoryview(data)), time_s))

    def _measure(self) -> None:
        pause, count = threading.Event(), 1 + len(self.bin.compartments)
        while not pause.wait(PERIOD_S):
            try:
                answer = self._cells.read_input_registers(0, count=2 * count, device_id=_CELLS_UNIT)
                words = struct.pack(f">{2 * count}H", *answer.registers)
            except (ModbusException, OSError, struct.error) as error:
                print(f"no reading: {error}", flush=True)
                self._cells.close()
                continue
            range_m, *weights_n = struct.unpack(f">{count}f", words)
            now_s = self.process.clock.now_s()
            self.todo.put(partial(self.seen, SimpleNamespace(range=range_m), now_s))
            for name, weight_n in zip(self.bin.compartments, weights_n, strict=True):
                self.todo.put(partial(self.weighed, name, weight_n, now_s))


if __name__ == "__main__":
    sys.exit(main_of_one("itrash", "bin", names, bin_process, partial(run, make=LabBin), "The lab's bin."))
