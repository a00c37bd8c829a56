"""A site that is broken on purpose: a few cases of `make bench ONLY=faults`."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.long

CASES = ("disk_full_bridge", "journal_deleted", "killed_everything", "node_forgets_transactions")


def test_a_site_survives_a_full_disk_a_lost_file_a_power_cut_and_a_node_that_lies() -> None:
    done = subprocess.run([sys.executable, "-m", "bench.faults", *CASES], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{len(CASES)} of {len(CASES)} survived" in done.stdout
