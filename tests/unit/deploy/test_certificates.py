"""What making certificates says."""

from __future__ import annotations

from pathlib import Path

from deploy.certificates import report


def test_a_second_run_says_that_nothing_had_to_be_made() -> None:
    said = report(Path("/site/tls"), [])
    assert "already" in said and "nothing" not in said


def test_what_was_made_is_listed_with_its_folder() -> None:
    assert report(Path("/site/tls"), ["bridge", "oracle"]) == "Generated in /site/tls: bridge, oracle."
