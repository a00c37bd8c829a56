"""What the commands share."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rodeo.errors import InvalidRequest
from rodeo_cli import app
from rodeo_cli.common import write_file


def test_a_file_that_cannot_be_written_is_named_with_the_reason(tmp_path: Path) -> None:
    named = tmp_path / "nothing" / "request.json"
    with pytest.raises(InvalidRequest, match="cannot be written") as refused:
        write_file(named, "{}\n")
    assert refused.value.details == {"file": str(named), "problem": "No such file or directory"}
    named.parent.mkdir()
    write_file(named, "{}\n")
    assert named.read_text() == "{}\n"


@pytest.mark.parametrize("typed", [{}, {"primaryType": "RegisterTask", "message": []}])
def test_what_is_no_signed_task_cannot_be_revoked(tmp_path: Path, typed: dict[str, object]) -> None:
    file = tmp_path / "task.json"
    file.write_text(json.dumps({"request": {"typed_data": typed}}))
    done = CliRunner().invoke(app, ["task", "revoke", str(file), "--as", "alice"])
    assert done.exit_code == 1 and done.output.startswith("invalid_request: "), done.output
