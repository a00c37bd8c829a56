"""anvil (Foundry) in place of the embedded chain: a child process on the same URL, on the site's clock."""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any

from deploy.chain.errors import AnvilFailed
from deploy.chain.server import PURPOSE, host_and_port
from rodeo.errors import AlreadyRunning
from rodeo.host.http import listen
from rodeo.host.instance import lock_instance
from rodeo.runtime.process import die_with

log = logging.getLogger(__name__)

_PREBUILT = "node_modules/@foundry-rs/anvil-*/bin/anvil"
"""The program itself inside the npm package, whose `.bin/anvil` would put a Node process in between."""

_START_S = 20.0
_STOP_S = 20.0
_CLOCK_PERIOD_S = 0.05
"""Wall time between two settings of anvil's time: block time lags by this times the clock's speed at most."""

_STATE_INTERVAL_S = 60
"""anvil writes its whole state each time, and answers nobody meanwhile. It also does when it ends, even when
this process is killed, so that only a power cut takes what came since."""

STATE_FILE = "anvil.json"


class Anvil:
    """The anvil process, from entering to leaving; it ends with this process however this one ends.

    `now_s()` as for `LocalChain`. State lives in `folder`. Entering raises AnvilFailed or PortUnavailable.
    """

    def __init__(
        self, url: str, folder: Path, chain_id: int, genesis_time_s: int, now_s: Callable[[], int | None]
    ) -> None:
        self._url = url
        self._host, self._port = host_and_port(url)
        self._state = folder / STATE_FILE
        self._folder = folder
        self._chain_id = chain_id
        self._genesis_time_s = genesis_time_s
        self._now_s = now_s
        self._stop = threading.Event()

    def __enter__(self) -> Anvil:
        self._lock = self._wait_for_predecessor()
        # Before anvil finds out: another server there must not be taken for it, nor have its time set.
        listen(self._host, self._port, PURPOSE).close()
        self._process = subprocess.Popen(
            [
                *_find_anvil(),
                *("--host", self._host, "--port", str(self._port), "--chain-id", str(self._chain_id)),
                *("--timestamp", str(self._genesis_time_s), "--state", str(self._state)),
                *("--state-interval", str(_STATE_INTERVAL_S), "--silent"),
            ],
            # anvil holds the folder's lock as well, so that a successor waits until it has written its state.
            pass_fds=[self._lock],
            preexec_fn=partial(die_with, os.getpid(), signal.SIGTERM),
        )
        self._wait_until_up()
        self._clock = threading.Thread(target=self._feed_clock, name="anvil-clock", daemon=True)
        self._clock.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._stop.set()
        self._clock.join()
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            log.error("anvil did not stop within %s s; its state since the last save is lost", _STOP_S)
        os.close(self._lock)

    def wait(self, stop: threading.Event) -> None:
        """Block until `stop` is set. Raises AnvilFailed when anvil ends by itself."""
        while not stop.wait(_CLOCK_PERIOD_S):
            self._check_alive()

    def block_number(self) -> int:
        """Raises AnvilFailed when anvil does not answer."""
        try:
            return int(self._rpc("eth_blockNumber"), 16)
        except (OSError, HTTPException) as error:
            raise AnvilFailed("anvil does not answer", reason=str(error)) from error

    def _wait_for_predecessor(self) -> int:
        deadline_s = time.monotonic() + _STOP_S
        while True:
            try:
                return lock_instance(self._folder)
            except AlreadyRunning:
                if time.monotonic() > deadline_s:
                    raise
                self._stop.wait(_CLOCK_PERIOD_S)

    def _wait_until_up(self) -> None:
        deadline_s = time.monotonic() + _START_S
        while True:
            self._check_alive()
            try:
                # anvil starts at the time of its genesis again; blocks must continue from the newest one.
                self._set_time(int(self._rpc("eth_getBlockByNumber", "latest", False)["timestamp"], 16))
                return
            except (OSError, HTTPException) as error:
                if time.monotonic() > deadline_s:
                    raise AnvilFailed("anvil does not answer", waited_s=_START_S) from error
                self._stop.wait(_CLOCK_PERIOD_S)

    def _check_alive(self) -> None:
        status = self._process.poll()
        if status is not None:
            raise AnvilFailed("anvil exited unexpectedly", exit_status=status, state=str(self._state))

    def _feed_clock(self) -> None:
        told_s = 0
        while not self._stop.wait(_CLOCK_PERIOD_S):
            # Told as often as it is asked: anvil's own clock runs on at the speed of the wall.
            told_s = max(told_s, self._now_s() or 0)
            if not told_s:
                continue
            try:
                self._set_time(told_s)
            except (OSError, HTTPException, AnvilFailed) as error:
                log.warning("cannot set anvil's clock: %s", error)

    def _set_time(self, time_s: int) -> None:
        self._rpc("anvil_setTime", time_s)

    def _rpc(self, method: str, *params: Any) -> Any:
        connection = HTTPConnection(self._host, self._port, timeout=5.0)
        try:
            body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params})
            connection.request("POST", "/", body, {"content-type": "application/json"})
            reply = json.loads(connection.getresponse().read())
        finally:
            connection.close()
        if "error" in reply:
            raise AnvilFailed(f"anvil refused {method}", **reply["error"])
        return reply["result"]


def _find_anvil() -> Sequence[str]:
    """anvil from this repository's node_modules, or from PATH. Raises AnvilFailed."""
    program = next(map(str, Path(__file__).parents[2].glob(_PREBUILT)), None) or shutil.which("anvil")
    if program is None:
        raise AnvilFailed(
            "anvil is not installed: with Node 18 or newer `make setup` installs it; or put Foundry's "
            "anvil on the PATH"
        )
    return [program]
