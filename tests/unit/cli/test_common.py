"""What the commands share."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.errors import InvalidRequest
from rodeo_cli.common import write_file


def test_a_file_that_cannot_be_written_is_named_with_the_reason(tmp_path: Path) -> None:
    named = tmp_path / "nothing" / "request.json"
    with pytest.raises(InvalidRequest, match="cannot be written") as refused:
        write_file(named, "{}\n")
    assert refused.value.details == {"file": str(named), "problem": "No such file or directory"}
    named.parent.mkdir()
    write_file(named, "{}\n")
    assert named.read_text() == "{}\n"
