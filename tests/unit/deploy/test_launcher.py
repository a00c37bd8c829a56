"""What the launcher does with a process that ended by itself, with programs that end as they are told."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from deploy import launcher as launcher_module
from deploy.launcher import LONGEST_PAUSE_S, AllGaveUp, Launcher
from rodeo.host.instance import GAVE_UP
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import write_site

NAMES = ("oracle", "itrash")


def program(folder: Path, text: str) -> str:
    """A stand-in for the interpreter: called as `python -m MODULE ...`, it notes its start."""
    path = folder / "python"
    path.write_text(f'#!/bin/sh\ndate +%s.%N >> "{folder}/$2"\n{text}\n')
    path.chmod(0o755)
    return str(path)


def site(folder: Path) -> Path:
    # A chain elsewhere: no wallets are made.
    return write_site(folder, "external", "clock.speed = 1\nclock.idle_speed = 1")


def starts(folder: Path, name: str) -> list[float]:
    path = folder / f"services.{name}"
    return list(map(float, path.read_text().split())) if path.exists() else []


def poll_until(
    launcher: Launcher,
    holds: Callable[[], bool],
) -> None:
    wait_until(lambda: launcher.poll() or holds())


def test_what_no_restart_cures_is_started_once_and_its_reason_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(launcher_module, "time", SimpleNamespace(monotonic=lambda: now_s))
    hopeless = program(
        tmp_path,
        f'if [ "$2" != services.oracle ]; then exec sleep {2 * HANG_S:.0f}; fi\n'
        f'echo "12:00:00 ERROR oracle: config_error: no"; exit {GAVE_UP}',
    )
    with Launcher(site(tmp_path), NAMES, python=hopeless) as launcher:
        poll_until(launcher, lambda: "oracle" in launcher.given_up())
        ended = launcher.children["oracle"]
        for _ in range(3):
            now_s += 2 * LONGEST_PAUSE_S
            launcher.poll()
        assert launcher.children["oracle"] is ended and len(starts(tmp_path, "oracle")) == 1
        assert launcher.given_up() == {"oracle": "config_error: no"}
        assert list(launcher.running()) == ["itrash"]


def test_when_all_that_was_started_has_given_up_the_launcher_says_so(tmp_path: Path) -> None:
    hopeless = program(tmp_path, f'echo "no passphrase for $2"; exit {GAVE_UP}')
    with (
        Launcher(site(tmp_path), NAMES, python=hopeless) as launcher,
        pytest.raises(AllGaveUp, match=r"oracle: no passphrase for services\.oracle; itrash: no passphrase"),
    ):
        poll_until(launcher, lambda: False)


def test_what_a_restart_may_cure_is_started_again_after_longer_and_longer_pauses(tmp_path: Path) -> None:
    failing = program(tmp_path, "exit 1")
    with Launcher(site(tmp_path), ("oracle",), python=failing) as launcher:
        delays_s: list[float] = []

        def started_four_times() -> bool:
            delays_s.append(launcher.children["oracle"].delay_s)
            return len(starts(tmp_path, "oracle")) >= 4

        poll_until(launcher, started_four_times)
        assert delays_s == sorted(delays_s) and len(set(delays_s)) >= 3 and delays_s[-1] <= LONGEST_PAUSE_S
        poll_until(launcher, lambda: launcher.children["oracle"].restart_at_s is not None)
        # One that had run steadily before its end is started again promptly.
        launcher.children["oracle"].started_s = time.monotonic() - 3600
        launcher.children["oracle"].restart_at_s = None
        launcher.poll()
        assert launcher.children["oracle"].delay_s == 0.5
