"""`rodeo bin correct`: what nobody can sign is refused in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.site.config import Site
from rodeo_cli import app, bins
from tests.support.site import LAB

PICTURE = "0x" + "12" * 32


@pytest.mark.parametrize(
    ("words", "named"),
    [(("glass", "--picture", "0x1234"), "--picture"), (("g" * 33, "--picture", PICTURE), "CLASS")],
)
def test_what_nobody_can_sign_is_refused_by_its_option(
    words: tuple[str, ...], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def running(_site: Path) -> Iterator[tuple[Site, Any]]:
        yield Site.load(LAB), None

    contracts = SimpleNamespace(task_manager="0x" + "11" * 20, organization="0x" + "22" * 20)
    monkeypatch.setattr(bins, "connected", running)
    monkeypatch.setattr(bins.queries, "ask", lambda *_args: SimpleNamespace(chain_id=1, contracts=contracts))
    done = CliRunner().invoke(app, ["bin", "correct", *words])
    assert done.exit_code == 1
    assert isinstance(done.exception, SystemExit)  # not an error that nobody awaited
    assert named in done.output, done.output
