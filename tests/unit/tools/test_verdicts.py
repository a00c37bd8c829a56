"""The verdicts of two commits, side by side."""

import json
from pathlib import Path

from bench import verdicts
from bench.verdicts import Verdict, changes, read

ACCEPTED = Verdict("honest cleaning 1.0, none", "accepted", None, None, None)


def test_each_case_that_is_another_one_has_a_line(tmp_path: Path) -> None:
    refused = Verdict("forgery empty_hand", "rejected", None, None, "gripper_held")
    charge = Verdict("honest charge 3, heavy", "accepted", None, "180", None)
    before = tmp_path / "before.jsonl"
    before.write_text("".join(json.dumps(one._asdict()) + "\n" for one in (ACCEPTED, refused, charge)))
    after = [
        ACCEPTED,
        refused._replace(outcome="undecided", fault="motion capture", check="item_moved"),
        charge._replace(amount_iec="120"),
        Verdict("composed 7", "rejected", None, None, "sealed"),
    ]
    assert read(before) == [ACCEPTED, refused, charge]
    assert changes(read(before), after) == [
        "composed 7: no such case -> rejected, sealed",
        "forgery empty_hand: rejected, gripper_held -> undecided, item_moved, motion capture is at fault",
        "honest charge 3, heavy: accepted, 180 IEC -> accepted, 120 IEC",
    ]


def test_no_figure_without_another_commit(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("VERDICTS_BEFORE", raising=False)
    monkeypatch.setattr(verdicts, "_judged", lambda: [ACCEPTED, ACCEPTED._replace(outcome="rejected")])
    assert verdicts.run() == {"verdicts_accepted": 1, "verdicts_rejected": 1, "verdicts_changed": None}
    assert read(verdicts.OUT)[0] == ACCEPTED
