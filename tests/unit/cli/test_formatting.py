"""What the command line says to people: options instead of fields, names of what was meant, whole columns."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel
from rich.console import Console
from typer.testing import CliRunner

from rodeo.bus import messages
from rodeo.bus.session import validate
from rodeo.chain.node.errors import ContractReverted
from rodeo.chain.node.translation import why_unanswered
from rodeo.charging.orders import ChargingParams
from rodeo.checks.report import Check, Report, at_most, equal, skipped
from rodeo.commands import Command
from rodeo.commands.devices import RegisterDevice
from rodeo.commands.judging import Challenge
from rodeo.commands.organization import AllowKind, SetTerms
from rodeo.commands.tasks import RegisterTask
from rodeo.commands.treasury import Deposit
from rodeo.display import formatting as display
from rodeo.display.formatting import phrase
from rodeo.errors import InvalidRequest, RemoteError, RodeoError
from rodeo.lab.render import encode
from rodeo.person import photos
from rodeo.person.pace import running_out_s
from rodeo.site.config import Site
from rodeo_cli import (
    app,
    common,
    disputes,
    formatting,
    forms,
    organization,
    robot,
    robot_words,
    task_params,
    task_words,
    tasks,
    verify,
)
from rodeo_cli import report as report_command
from rodeo_cli.layout import lines
from rodeo_kinds.waste_disposal.params import CleaningParams
from tests.support.command import tree
from tests.support.site import LAB
from tests.support.tasks import task as whole_task


def told(model: type[BaseModel], data: dict[str, Any], command: Callable[..., Any]) -> str:
    """What the command says of a request that the bridge refused."""
    with pytest.raises(InvalidRequest) as refused:
        validate(model, data)
    answer = RemoteError(refused.value.code, refused.value.message, refused.value.details)
    return formatting.explain(answer, formatting.options_of(command))


def form_of(model: type[Command]) -> Callable[..., Any]:
    assert model.declared.line is not None
    return forms.form(model, model.declared.line)


@pytest.mark.parametrize(
    ("model", "data", "command", "says"),
    [
        (CleaningParams, {}, tasks.create, ["pass --x-m X_M"]),
        (ChargingParams, {"robot": "r", "dock": "d"}, tasks.create, ["pass --soc-from SOC_FROM"]),
        (
            RegisterTask,
            {"kind": "No Kind", "reward_iec": "ten", "max_attempts": 999},
            tasks.create,
            ["KIND: ", "--reward: enter an amount of IEC", "--max-attempts: "],
        ),
        (AllowKind, {"kind": "sweeping"}, form_of(AllowKind), ["--judge is needed"]),
        (
            AllowKind,
            {"kind": "sweeping", "judge": "auditor", "min_verdict_window_s": 60},
            form_of(AllowKind),
            ["--min-verdict-window and --max-verdict-window go together"],
        ),
        (SetTerms, {"bond_iec": "-5"}, form_of(SetTerms), ["--bond: "]),
        (Deposit, {"amount_iec": "0"}, form_of(Deposit), ["AMOUNT: "]),
        (
            RegisterDevice,
            {"device": "0x1"},
            form_of(RegisterDevice),
            ["ADDRESS: ", "pass --owner OWNER"],
        ),
    ],
)
def test_a_refused_request_names_the_options_and_no_fields(
    model: type[BaseModel], data: dict[str, Any], command: Callable[..., Any], says: list[str]
) -> None:
    sentence = told(model, data, command)
    assert all(one in sentence for one in says), sentence
    assert model.__name__ not in sentence and "_iec" not in sentence and "does not fit" not in sentence


def test_a_contracts_error_says_amounts_in_iec() -> None:
    error = ContractReverted(
        "ERC20InsufficientBalance", {"sender": "0x1", "balance": 10**17, "needed": 5 * 10**18}
    )
    assert error.details == {"sender": "0x1", "balance_iec": "0.1", "needed_iec": "5"}
    assert "needed: 5 IEC" in formatting.explain(error, {})


def test_what_is_no_amount_of_iec_in_a_contracts_error_stays_as_it_is() -> None:
    assert ContractReverted("InvalidWindow", {"window": 5, "min": 60, "max": 100}).details["max"] == 100


def test_what_is_left_of_a_budget_is_an_amount_and_its_end_a_time() -> None:
    error = ContractReverted(
        "OverBudget",
        {"role": "OPERATOR_ROLE", "amount": 10**20, "left": 5 * 10**19, "until": 1_795_765_311},
    )
    said = formatting.explain(error, {})
    assert "amount: 100 IEC, left: 50 IEC" in said and "until: 2026-11-27 07:41:51" in said
    error = ContractReverted("BondTooHigh", {"bond": 10**18, "max_bond": 10**17})
    assert formatting.explain(error, {}).endswith("(bond: 1 IEC, max bond: 0.1 IEC)")


def test_votes_and_times_that_are_needed_are_no_amounts() -> None:
    error = ContractReverted("TooFewVotes", {"task_id": 1, "votes": 2, "needed": 3})
    assert formatting.explain(error, {}).endswith("(task id: 1, votes: 2, needed: 3)")
    error = ContractReverted("TooLate", {"task_id": 1, "needed": 1_795_765_312, "deadline": 1_795_765_311})
    said = formatting.explain(error, {})
    assert "needed: 2026-11-27 07:41:52 by" in said and "deadline: 2026-11-27 07:41:51 by" in said


def test_a_time_in_seconds_is_no_duration() -> None:
    error = RodeoError("run it again later", ready_s=1_795_765_312, waited_s=90)
    said = formatting.explain(error, {})
    assert said == "run it again later (ready: 2026-11-27 07:41:52 by the chain's clock, waited: 1 min 30 s)"


@pytest.mark.parametrize(
    "name", ["NonceUsed", "NotSignedBy", "RequestExpired", "TasksArePaused", "WindowOver"]
)
def test_what_people_meet_is_a_sentence(name: str) -> None:
    assert "the contract refused" not in formatting.explain(ContractReverted(name, {}), {})


def test_the_name_of_a_contracts_error_becomes_words() -> None:
    error = ContractReverted("NotInPanel", {"task_id": 1})
    assert formatting.explain(error, {}) == "the contract refused: not in panel (task id: 1)"
    assert phrase("NotAJudge") == "Not a judge" and phrase("TaskSettled") == "Task settled"


def test_a_value_that_is_an_account_with_a_name_is_only_the_name() -> None:
    error = RodeoError("too little", account="0x" + "1" * 40, name="alice", needed_iec="7")
    assert formatting.explain(error, {}) == "too little (name: alice, needed: 7 IEC)"


def test_nested_causes_of_a_silent_node_become_one_short_reason() -> None:
    refused = ConnectionRefusedError(111, "Connection refused")
    nested = OSError(RuntimeError("HTTPConnectionPool(host='127.0.0.1', port=1): Max retries exceeded"))
    nested.__cause__ = refused
    assert why_unanswered(nested) == "connection refused"
    assert why_unanswered(TimeoutError("x" * 500)) == "no answer in time"


def test_times_of_a_simulated_site_are_marked_as_such() -> None:
    site = Site.load(LAB)
    assert formatting.moment(0, site) == "1970-01-01 00:00:00 (simulated time)"
    wall = site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})
    assert formatting.moment(0, wall).endswith("UTC")


@pytest.mark.parametrize("order", robot.ORDERS)
@pytest.mark.parametrize("task_id", [None, 7])
def test_a_robots_reply_to_an_order_is_a_sentence(order: str, task_id: int | None) -> None:
    said = robot_words.taken("panther1", order, {"task_id": task_id, "activity": "paused by an operator"})
    assert said.startswith("panther1 ") and said.endswith(".") and "paused by an operator" not in said


def test_a_robots_state_is_told_in_words() -> None:
    state = {"paused": True, "stopped": False, "soc": 0.5, "working_w": 174.7, "docked": False, "eta_s": 90}
    said = dict(robot_words.facts(state))
    assert said["power at work"] == "175 W" and said["orders"] == "take no new work"
    assert said["battery"] == "50%" and said["time left"] == "1 min 30 s" and said["on the dock"] == "no"
    assert not any("_" in label for label in said)


def test_a_challenge_needs_a_reason() -> None:
    data = {"task_id": 1, "reason": " "}
    assert "--reason: give a reason" in told(Challenge, data, form_of(Challenge))


def test_an_unknown_kind_is_what_is_wrong_and_not_its_parameter() -> None:
    with pytest.raises(InvalidRequest) as refused:
        task_params.task_params(Site.load(LAB), "waste", ["--item-id", "item1"], None)
    said = formatting.explain(refused.value, {})
    assert "no such kind" in said and "listed: battery_charging, waste_disposal" in said


def test_a_place_is_one_option_and_a_photo_is_kept_in_the_store(tmp_path: Path) -> None:
    site = Site.load(LAB).model_copy(update={"data_dir": tmp_path})
    (tmp_path / "can.png").write_bytes(encode(np.zeros((8, 8, 3), np.uint8), ".png"))
    flags = [f"--photo={tmp_path / 'can.png'}", "--bin", "itrash"]
    found = task_params.task_params(site, "waste_disposal", flags, None, "3.2,1.4")
    assert (found["x_m"], found["y_m"], found["bin"]) == (3.2, 1.4, "itrash")
    assert photos.kept(site, found["photo"]) == (tmp_path / "can.png").read_bytes()
    assert task_params.task_params(site, "waste_disposal", [], json.dumps(found)) == found


@pytest.mark.parametrize(
    ("kind", "at", "flags", "words"),
    [
        ("waste_disposal", "3.2", [], "3.2,1.4"),
        ("waste_disposal", "3.2,1.4", ["--photo", "no.jpg"], "cannot read the photo"),
        ("waste_disposal", "3.2,2.9", [], "desk2 stands there"),
        ("battery_charging", "3.2,1.4", [], "no place on the map"),
    ],
)
def test_a_place_that_is_none_and_a_file_that_is_no_photo_are_refused(
    kind: str, at: str, flags: list[str], words: str
) -> None:
    with pytest.raises(InvalidRequest) as refused:
        task_params.task_params(Site.load(LAB), kind, flags, None, at)
    assert words in formatting.explain(refused.value, {})


def test_a_report_on_who_or_what_nobody_knows_is_refused() -> None:
    known = {"organization", "panther1"}
    report_command.require("participant", ["panther1"], known)
    with pytest.raises(InvalidRequest) as refused:
        report_command.require("participant", ["panther1", "panter1"], known)
    assert refused.value.details == {"participant": ["panter1"], "known": ["organization", "panther1"]}


def test_a_task_says_which_ruling_stands_and_how_long_it_can_be_challenged() -> None:
    standing = messages.Standing(ruling="rejected", until=3600.0)
    stands = messages.Dispute(instance=0, until=3600.0)
    challenged = messages.Dispute(instance=0, until=3600.0, challenger="0x1", because="it lies there")
    waits = whole_task("ruled").model_copy(
        update={"verdict_deadline": 7200.0, "standing": standing, "reason": "nothing was lifted"}
    )
    one = waits.model_copy(update={"dispute": stands})
    said = dict(task_words.facts(one, Site.load(LAB)))
    until = "1970-01-01 01:00:00 (simulated time)"
    assert said["stands"] == f"rejected: nothing was lifted; it can be challenged until {until}"
    assert not said["due by"] and running_out_s(one) == 3600
    assert said["stands"] in "\n".join(listed(one, width=500))
    one = waits.model_copy(update={"dispute": challenged})
    said = dict(task_words.facts(one, Site.load(LAB)))
    assert "challenged: it lies there" in said["stands"] and until in said["stands"]
    plain = one.model_copy(update={"proof_uri": "file:///store/aa.mcap"})
    said = dict(disputes.facts(Site.load(LAB), plain, challenged))
    assert said["replay"] == "rodeo verify /store/aa.mcap" and said["report"] == "no report"
    hostile = one.model_copy(update={"proof_uri": "file:///store/aa.mcap; reboot"})
    said = dict(disputes.facts(Site.load(LAB), hostile, challenged))
    assert said["replay"] == "rodeo verify '/store/aa.mcap; reboot'", "one argument of a shell's command"


# -- tables -----------------------------------------------------------------------------------------------


def task(**changes: Any) -> messages.Task:
    fields = {
        "id": 12,
        "kind": "wheel_cleaning",
        "state": "failed",
        "attempt": 3,
        "max_attempts": 3,
        "creator": "0x" + "1" * 40,
        "creator_name": "organization",
        "executor": "0x" + "2" * 40,
        "executor_name": "panther1",
        "reward_iec": Decimal("100"),
        "paid_iec": Decimal("0"),
        "verdict": "rejected",
        "reason": "grasp: the item does not rise in the gripper (0 m, limit 0.1 m)",
    } | changes
    return messages.Task.model_construct(**fields)


def listed(*several: messages.Task, width: int = 80) -> list[str]:
    columns = ("id", "kind", "state", "try", "creator", "executor", "reward", "paid")
    return [
        line.plain
        for line in lines(columns, [task_words.row(t, Site.load(LAB)) for t in several], width, (1, 4, 5))
    ]


def test_kinds_and_names_are_whole_in_eighty_columns_and_a_failure_has_its_reason() -> None:
    settled = task(
        kind="waste_disposal", state="settled", verdict="accepted", reason="accepted", paid_iec="100"
    )
    shown = listed(task(), settled)
    assert all(len(line) <= 80 for line in shown)
    text = "\n".join(shown)
    assert all(one in text for one in ("wheel_cleaning", "waste_disposal", "organization", "panther1"))
    assert "grasp: the item does not rise in the gripper" in text
    assert len(shown) == 4


def test_what_has_no_room_is_continued_below_and_never_cut() -> None:
    shown = listed(task(kind="a_very_long_kind_of_work_indeed", creator_name="somebody_with_a_long_name" * 2))
    assert all(len(line) <= 80 for line in shown) and "…" not in "".join(shown)
    assert "indeed" in "\n".join(shown)


def test_a_window_that_passed_is_a_reason_too() -> None:
    assert "in time" in "\n".join(listed(task(verdict="expired", reason=None)))


def report() -> Report:
    found = [
        ("base_speed", at_most(0.7, 2.1, "m/s", "Husarion Panther: 2 m/s", "fastest by motion capture" * 4)),
        ("task_binding", equal("31337 0x" + "c" * 40, "31337 0x" + "c" * 40, "the assignment on chain")),
        ("signer", skipped("no chain to ask")),
    ]
    return Report.of([Check(name=name, **finding.model_dump()) for name, finding in found])


def test_verify_says_one_line_per_check_in_eighty_columns() -> None:
    shown = [line.plain for line in verify.check_lines(report(), 80, verbose=False)]
    assert [line.split()[:2] for line in shown] == [
        ["passed", "base_speed"], ["passed", "task_binding"], ["skipped", "signer"]
    ]  # fmt: skip
    assert all(len(line) <= 80 for line in shown)
    assert not any("Husarion" in line for line in shown)


def test_verify_says_limit_and_source_where_more_is_asked_for() -> None:
    text = " ".join(" ".join(line.plain.split()) for line in verify.check_lines(report(), 80, verbose=True))
    assert "limit 2.1 m/s; from: Husarion Panther: 2 m/s" in text and "…" not in text


def test_an_accepted_proof_says_how_much_was_asked() -> None:
    assert verify.outcome(report()) == "2 checks passed, 1 were skipped"


def test_the_state_of_a_withdrawn_key_is_whole_below_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    device = {
        "role": "bin",
        "name": "itrash2",
        "owner_name": "organization",
        "owner": "",
        "address": "0x" + "1" * 40,
    }
    device |= {"revoked": 5.0, "revoked_because": "superseded"}

    @contextmanager
    def running(_site: Path) -> Iterator[tuple[Site, Any]]:
        yield Site.load(LAB), SimpleNamespace(query=lambda *_args, **_more: {"devices": [device]})

    monkeypatch.setattr(organization, "connected", running)
    monkeypatch.setattr(common, "console", Console(width=80))
    shown = CliRunner().invoke(app, ["organization", "devices"]).output.splitlines()
    assert "organization" in shown[1] and shown[2].strip() == "revoked: superseded"
    assert all(len(line) <= 80 for line in shown)


def leaves(node: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, inner in getattr(node, "commands", {}).items():
        yield from leaves(inner, f"{path} {name}")
    if not hasattr(node, "commands"):
        yield path, node


@pytest.mark.parametrize("leaf", list(leaves(tree(), "rodeo")), ids=lambda one: one[0])
def test_the_options_of_every_command_are_told_as_its_help_tells_them(leaf: tuple[str, Any]) -> None:
    name, node = leaf
    spelled = {spelling for one in node.params for spelling in (*one.opts, *one.secondary_opts)}
    for parameter, told in formatting.options_of(inspect.unwrap(node.callback)).items():
        metavars = {(one.metavar or "").removesuffix("...") for one in node.params}
        assert told in spelled | metavars or told == parameter.upper(), (name, told)


def test_an_amount_is_shown_in_eur_too_where_the_site_names_a_rate(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\neconomy.eur_per_iec = 0.05\n')
    rated, plain = Site.load(path), Site.load(LAB)
    assert formatting.worth("1234.6", rated) == "1,234.6 IEC (61.73 EUR)"
    assert formatting.worth(None, rated) == "0 IEC (0.00 EUR)"
    assert formatting.worth("1234.5", plain) == formatting.iec("1234.5")
    assert display.worth(Decimal("-20"), rated) == "-20 IEC (-1.00 EUR)"
    assert display.worth(None, rated) == display.iec(None)
    told = dict(task_words.facts(whole_task("open", reward_iec=Decimal(100)), rated))
    assert told["reward"].startswith("100 IEC (5.00 EUR) by ")
