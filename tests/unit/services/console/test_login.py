"""The brake on guessing, and where people are sent after logging in."""

from __future__ import annotations

import pytest

from rodeo.config import ConsoleConfig
from rodeo.errors import ConfigError
from services.console.errors import TooManyAttempts
from services.console.guard import origins_of
from services.console.login import Throttle, local_path


def test_failures_close_the_login_until_the_window_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("services.console.login.time.monotonic", lambda: now[0])
    throttle = Throttle(limit=3, window_s=60)
    for _ in range(3):
        throttle.check("eve")
        throttle.failed("eve")
        now[0] += 10
    with pytest.raises(TooManyAttempts) as caught:
        throttle.check("eve")
    assert caught.value.details == {"retry_after_s": 31}
    throttle.check("ada")
    now[0] = 60.0
    throttle.check("eve")


def test_success_forgets_the_failures_before() -> None:
    throttle = Throttle(limit=1, window_s=60)
    throttle.failed("ada")
    throttle.succeeded("ada")
    throttle.check("ada")


@pytest.mark.parametrize(
    ("wanted", "sent"),
    [
        ("/tasks/3", "/tasks/3"),
        ("//evil.example", "/"),
        ("/\\evil.example", "/"),
        ("https://evil.example", "/"),
        ("/a\r\nSet-Cookie: x", "/"),
        ("", "/"),
    ],
)
def test_nobody_is_sent_elsewhere_after_logging_in(wanted: str, sent: str) -> None:
    assert local_path(wanted) == sent


def test_a_console_that_others_reach_needs_tls() -> None:
    with pytest.raises(ConfigError, match="TLS"):
        origins_of(ConsoleConfig(host="0.0.0.0"), 8088)
    assert origins_of(ConsoleConfig(host="0.0.0.0", origin="https://x.example"), 8088) == {
        "https://x.example"
    }
    assert "http://127.0.0.1:8088" in origins_of(ConsoleConfig(), 8088)
