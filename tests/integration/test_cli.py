"""`rodeo` as its user runs it: real commands, what they print and how they end."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from typer.testing import CliRunner

from rodeo.host.instance import lock_holder
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_testing.waiting import HANG_S
from tests.support import command
from tests.support.site import LAB_PROCESSES, NewSite, RunningSite, free_port, write_site

pytestmark = pytest.mark.long

RODEO = (sys.executable, "-m", "rodeo_cli")
QUIET = "clock.speed = 1.0\nclock.idle_speed = 20\nagent.explore_when_idle = false"
"""Time passes slowly: a site that simulates what it can keeps every core busy while commands are tested."""


def environment(site: Path) -> dict[str, str]:
    return {**os.environ, "RODEO_SITE": str(site), "COLUMNS": "200"}


def rodeo(
    site: Path, *arguments: str, status: int = 0, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command that must end with `status`."""
    done = command.rodeo(*arguments, env=environment(site), timeout_s=HANG_S, folder=cwd)
    assert done.returncode == status, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done


def processes(site: Path, status: int = 0) -> dict[str, dict[str, Any]]:
    """`rodeo status --json`, by process."""
    answer = json.loads(rodeo(site, "status", "--json", status=status).stdout)
    return {row["process"]: row for row in answer["processes"]}


def holders(site: Path) -> list[str]:
    """Processes and launchers at work on the site's data."""
    names = [process.name for process in LAB_PROCESSES]
    folder = Site.load(site).data_dir
    return [n for n in ("launcher", *(f"launcher/{n}" for n in names), *names) if lock_holder(folder / n)]


def line_with(output: Any, text: str) -> str:
    """The next line of a running command that has `text` in it."""
    seen = []
    for line in output:
        if text in line:
            return str(line)
        seen.append(line)
    raise AssertionError(f"{text!r} is not in {seen}")


@pytest.fixture(scope="module")
def up(new_site: NewSite) -> Iterator[Path]:
    """A site's organization, where panther1 offers its service: what most commands need."""
    with RunningSite(new_site(QUIET)) as running:
        running.start_founded("bridge")
        rodeo(running.path, "service", "offer", "waste_disposal", "--price", "100", "--as", "panther1")
        yield running.path


@pytest.fixture(scope="module")
def whole(new_site: NewSite) -> Iterator[Path]:
    """A whole site in the background; stopped from another folder at the end."""
    site = new_site(QUIET)
    try:
        started = rodeo(site, "up", "--detach")
        states = [line.split()[1] for line in started.stdout.splitlines()[1:]]
        assert states == ["ready"] * len(LAB_PROCESSES)
        yield site
        running = rodeo(site, "report", "--json").stdout
    finally:  # also a site that did not get ready in time
        stopped = rodeo(site, "down", cwd=Path("/"))
    left = rodeo(site, "report", "--json")
    assert left.stdout == running and "had indexed when it stopped" in left.stderr
    assert "launcher" in stopped.stdout and "robot_agent" in stopped.stdout
    assert holders(site) == []


# -- without a running site ------------------------------------------------------------------------------


def test_status_of_a_site_that_is_down(site_path: Path) -> None:
    rows = processes(site_path, status=1)
    assert [row["reason"] for row in rows.values()] == ["not running"] * len(LAB_PROCESSES)


def test_a_question_to_a_site_that_is_down_says_how_to_start_it(site_path: Path) -> None:
    done = rodeo(site_path, "task", "list", status=1)
    assert "bus_unavailable" in done.stderr and "rodeo up" in done.stderr


def test_down_on_a_site_that_is_down(site_path: Path) -> None:
    assert "was running" in rodeo(site_path, "down").stdout


@pytest.mark.parametrize("command", ["up", "wallet"])
def test_a_wrong_site_file_is_named_with_its_fields(tmp_path: Path, command: str) -> None:
    site = write_site(tmp_path, extra='chain.sped = 1\nclock.source = "moon"')
    done = rodeo(site, command, status=1)
    assert all(text in done.stderr for text in ("config_error", str(site), "chain.sped", "clock.source"))


def test_a_site_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert "no.toml" in rodeo(tmp_path / "no.toml", "status", status=1).stderr


@pytest.mark.parametrize("option", [[], ["--detach"]])
def test_an_unknown_process_is_told_what_there_is(site_path: Path, option: list[str]) -> None:
    done = rodeo(site_path, "up", *option, "--only", "coffee", status=1)
    assert "unknown_process" in done.stderr and "robot_sim" in done.stderr


def test_a_chain_elsewhere_is_none_of_the_sites_processes(tmp_path: Path) -> None:
    site = write_site(tmp_path, "external", "clock.speed = 1\nclock.idle_speed = 1")
    assert "chain" not in processes(site, status=1)


def test_a_proof_that_is_not_there_is_wrong_usage(site_path: Path, tmp_path: Path) -> None:
    assert "does not exist" in rodeo(site_path, "verify", str(tmp_path / "no.mcap"), status=2).stderr


def test_a_file_that_is_no_proof_is_rejected(site_path: Path) -> None:
    done = rodeo(site_path, "verify", __file__, status=1)
    assert "rejected" in done.stdout and "corrupt_proof" in done.stdout


# -- starting and stopping -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, signal.SIGTERM, signal.SIGHUP],
)
def test_up_tells_each_change_and_ends_with_all_it_started(site_path: Path, number: int) -> None:
    with subprocess.Popen(
        [*RODEO, "up", "router"], env=environment(site_path), stdout=subprocess.PIPE, text=True
    ) as command:
        line_with(command.stdout, "router not ready: starting")
        line_with(command.stdout, "router ready")
        command.send_signal(number)
        line_with(command.stdout, "stopped")
    assert command.returncode == 0
    assert holders(site_path) == []


def test_a_port_that_is_taken_is_said_where_the_user_looks(site_path: Path) -> None:
    port = free_port()
    with site_path.open("a") as file:
        file.write(f'[bus]\nopen = true\nrouter = "tcp/127.0.0.1:{port}"\n')
    with (
        socket.create_server(("127.0.0.1", port)),
        subprocess.Popen(
            [*RODEO, "up", "--anyway", "router"],
            env=environment(site_path),
            stdout=subprocess.PIPE,
            text=True,
        ) as command,
    ):
        line = line_with(command.stdout, "router down")
        command.terminate()
    assert "port_unavailable" in line and str(port) in line and "in use" in line


def test_what_no_restart_cures_is_told_at_once_and_stays_in_status(site_path: Path) -> None:
    (site_path.parent / "teapot.xml").write_text("short and stout")
    with site_path.open("a") as file:
        file.write('[[robots]]\nkinematics = "teapot.xml"\npose = { x_m = 1.4, y_m = 1.3 }\n')
    told = rodeo(site_path, "up", "--detach", "router", "robot_sim", status=1)
    assert "restarting would not help" in told.stderr, "it waited for what does not come"
    assert "config_error" in told.stderr and "teapot" in told.stderr and "rodeo down" in told.stderr
    row = processes(site_path, status=1)["robot_sim"]
    assert row["gave_up"] and "teapot" in row["reason"]
    log = (Site.load(site_path).data_dir / "logs" / "robot_sim.log").read_text()
    assert log.count("not a usable robot") == 1 and "robot_sim: ready" not in log
    rodeo(site_path, "down")
    assert processes(site_path, status=1)["robot_sim"]["gave_up"]


def test_a_single_process_has_one_launcher_which_down_ends_too(site_path: Path) -> None:
    rodeo(site_path, "up", "--detach", "--only", "router")
    assert holders(site_path) == ["launcher/router", "router"]
    again = rodeo(site_path, "up", "--only", "router", status=1)
    assert "already_running" in again.stderr and "rodeo down" in again.stderr
    rodeo(site_path, "down")
    assert holders(site_path) == []


def test_a_process_without_a_router_is_not_called_down(running: RunningSite) -> None:
    running.start("router", "oracle")
    running.kill("router")
    row = processes(running.path, status=1)["oracle"]
    assert row["up"] and not row["ready"] and "no router" in row["reason"]


def test_processes_of_another_site_on_the_same_bus_are_told_apart(
    running: RunningSite, tmp_path: Path
) -> None:
    running.start("router")
    other = tmp_path / "other.toml"
    router = json.dumps(running.site.bus.router)
    other.write_text(
        f'extends = {json.dumps(str(running.path))}\ndata_dir = "other"\nbus.router = {router}\n'
    )
    row = processes(other, status=1)["router"]
    assert row["ready"] and not row["here"]
    assert processes(running.path, status=1)["router"]["here"]


# -- on a running site -----------------------------------------------------------------------------------


def test_status_of_a_running_site(whole: Path) -> None:
    rows = processes(whole)
    assert all(row["ready"] and row["here"] for row in rows.values())
    assert list(rows) == [process.name for process in LAB_PROCESSES]
    services = rodeo(whole, "service", "list").stdout
    assert "panther1" in services and "100 IEC" in services
    assert "no task is assigned" in rodeo(whole, "robot", "explain", "panther1", "--limit", "1000").stdout
    assert "no decision with task 999" in rodeo(whole, "robot", "explain", "panther1", "--task", "999").stdout


def test_a_second_launcher_is_refused(whole: Path) -> None:
    done = rodeo(whole, "up", status=1)
    assert "already_running" in done.stderr and "rodeo down" in done.stderr


def test_a_killed_process_is_seen_and_comes_back(whole: Path) -> None:
    killed = processes(whole)["oracle"]["pid"]
    os.kill(killed, signal.SIGKILL)
    rodeo(whole, "up", "--detach")
    assert processes(whole)["oracle"]["pid"] != killed
    log = (Site.load(whole).data_dir / "logs" / "launcher.log").read_text()
    assert "oracle down: ended on SIGKILL" in log


def test_a_task_is_posted_shown_listed_and_cancelled(up: Path) -> None:
    text = "[/red] careful: [bold]glass"
    create = ("task", "create", "waste_disposal", "--item-id", "item1", "--reward", "1", "--wait")
    nobodys = rodeo(up, *create, "--service", "12345", status=1)
    assert "unknown_service" in nobodys.stderr
    (service,) = [
        str(one["id"])
        for one in json.loads(rodeo(up, "service", "list", "--json").stdout)["services"]
        if one["kind"] == "waste_disposal"
    ]
    posted = json.loads(rodeo(up, *create, "--service", service, "--description", text, "--json").stdout)
    task_id = str(posted["task_id"])
    shown = rodeo(up, "task", "show", task_id).stdout
    assert text in shown and "open" in shown
    assert ["named", "service", service] in [line.split() for line in shown.splitlines()]
    assert json.loads(rodeo(up, "task", "show", task_id, "--json").stdout)["params"]["item_id"] == "item1"
    assert "waste_disposal" in rodeo(up, "task", "list", "--state", "open").stdout
    rodeo(up, "task", "cancel", task_id)
    assert "cancelled" in rodeo(up, "task", "list").stdout
    only = ("--participant", "organization", "--kind", "waste_disposal")
    (line,) = json.loads(rodeo(up, "report", "--json", *only).stdout)
    assert (line["done"], line["bought"]) == (0, 0)
    assert line["transactions"] >= 2 and line["gas"] > 100_000
    assert rodeo(up, "report", "--csv", "--to", "2001-01-01").stdout.startswith("week,participant,kind,done")
    assert "<svg" in rodeo(up, "report", "--html").stdout


def test_a_task_for_one_provider_alone_is_posted_and_shown(up: Path) -> None:
    create = ("task", "create", "waste_disposal", "--item-id", "item1", "--reward", "1", "--wait")
    nobodys = rodeo(up, *create, "--provider", "oracle", status=1)
    assert "provider_without_service" in nobodys.stderr and "oracle" in nobodys.stderr
    both = rodeo(up, *create, "--provider", "panther1", "--service", "1", status=1)
    assert "name a service or a provider, not both" in both.stderr
    posted = json.loads(rodeo(up, *create, "--provider", "panther1", "--json").stdout)
    task_id = str(posted["task_id"])
    shown = rodeo(up, "task", "show", task_id).stdout
    assert ["named", "provider", "panther1"] in [line.split() for line in shown.splitlines()]
    told = json.loads(rodeo(up, "task", "show", task_id, "--json").stdout)
    assert (told["requested_provider_name"], told["state"]) == ("panther1", "open")
    rodeo(up, "task", "cancel", task_id)


def test_a_reward_rises_while_nobody_takes_the_task(whole: Path) -> None:
    create = ("task", "create", "waste_disposal", "--item-id", "item1", "--reward", "1", "--wait")
    rises = ("--reward-up-to", "1.15", "--rise", "0.1", "--rise-every", "1")
    said = rodeo(whole, *create, *rises).stdout
    assert "for 1.1 IEC" in said and "for 1.15 IEC" in said and "the highest reward" in said
    (task,) = json.loads(rodeo(whole, "task", "list", "--state", "open", "--json").stdout)["tasks"]
    assert task["reward_iec"] == "1.15" and f"Task {task['id']} has" in said
    rodeo(whole, "task", "cancel", str(task["id"]))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--reward", "1", "--item-id", "item1"), ("reward_below_price", "100 IEC", "--wait")),
        (("--reward", "100000", "--item-id", "item1"), ("insufficient_funds",)),
        (("--reward", "ten", "--item-id", "item1"), ("invalid_request", "--reward: enter an amount of IEC")),
        (("--reward", "100", "--item-id", "item99"), ("--item-id: choose one of this site", "item1")),
        (("--reward", "100"), ("invalid_request", "choose an item, or the place on the map")),
        (("--reward", "100", "--params", "{"), ("malformed_json", "--params")),
        (("--reward", "100", "--item-id", "item1", "--as", "bob"), ("unknown_participant", "organization")),
        (("--reward", "100", "--item-id", "item1", "--as", ""), ("invalid_request",)),
    ],
)
def test_a_task_that_cannot_be_posted_says_why(
    up: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    done = rodeo(up, "task", "create", "waste_disposal", *arguments, status=1)
    assert all(word in done.stderr for word in words), done.stderr


def test_the_organization_is_run_from_a_terminal(up: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def organization(*arguments: str, status: int = 0) -> str:
        # In this process: the same code, without a second for each start of an interpreter.
        done = CliRunner().invoke(app, ["organization", *arguments, "--site", str(up)])
        assert done.exit_code == status, done.output
        return str(done.output)

    def state() -> dict[str, Any]:
        return dict(json.loads(organization("show", "--json")))

    before = state()
    organization("policy", "lowest_price")
    organization("kind", "sweeping", "--judge", "auditor", "--min-window", "120", "--reference-price", "45")
    organization("terms", "--bond", "50", "--penalty", "20", "--max-failures", "2")
    organization("members-only")
    organization("admit", "panther1")
    organization("grant", "auditor", "panther1")
    organization("budget", "operator", "1000")
    organization("budget", "treasurer", "5", "--period", "8640000")
    organization("withdraw", "5", "--to", "panther1")
    refusal = organization("withdraw", "1", "--to", "panther1", status=1)
    assert "over_budget" in refusal
    create = ("task", "create", "waste_disposal", "--item-id", "item1", "--reward", "1", "--wait")
    organization("pause", "259200")
    assert "tasks_are_paused" in rodeo(up, *create, status=1).stderr
    assert "none before" in organization("show")
    organization("resume")
    assert "paused_recently" in organization("pause", "3600", status=1)
    rodeo(up, "task", "cancel", str(json.loads(rodeo(up, *create, "--json").stdout)["task_id"]))
    key = Account.from_key("0x" + "ab" * 32)
    device, owner = key.address, ("--owner", "organization")
    monkeypatch.setenv("RODEO_KEY_ITRASH2_DEVICE", key.key.hex())
    signature = organization("sign-device", "itrash2-device", *owner).strip()
    about = ("--role", "bin", *owner, "--name", "itrash2")
    assert "not_signed_by_device" in organization(
        "register-device", device, *about, "--signature", "0x" + "12" * 64, status=1
    )
    organization("register-device", device.lower(), *about, "--signature", signature)
    now = state()
    assert (now["policy"], now["members_only"]) == ("lowest_price", True)
    assert now["terms"] == {"bond_iec": "50", "penalty_iec": "20", "max_failures": 2}
    rules = {
        "kind": "sweeping",
        "allowed": True,
        "judge": "auditor",
        "min_window_s": 120,
        "reference_price_iec": "45",
    }
    rules |= {"min_verdict_window_s": 900, "max_verdict_window_s": 604_800}
    rules |= {"audit_window_s": 0, "removed": False, "rules_sha256": []}
    rules |= {"votes": 0, "panel": 0, "rotation_s": 0, "seats": [], "judge_stake_iec": "0"}
    (sweeping,) = [one for one in now["kinds"] if one["kind"] == "sweeping"]
    assert sweeping.items() >= rules.items()
    assert {role: (one["amount_iec"], one["period_s"]) for role, one in now["budgets"].items()} == {
        "OPERATOR_ROLE": ("1000", 86_400),
        "TREASURER_ROLE": ("5", 8_640_000),
    }
    assert "panther1" in {one["name"] for one in now["roles"]["AUDITOR_ROLE"]}
    assert "panther1" in {one["name"] for one in now["roles"]["MEMBER_ROLE"]}
    assert Decimal(now["treasury_iec"]) == Decimal(before["treasury_iec"]) - 5
    shown = organization("show")
    assert "5 IEC in 100 d" in shown and "bond 50 IEC" in shown and "open to" in shown and "members" in shown
    assert "meter" in organization("devices")
    # Back to what the other tests find.
    organization("revoke-device", device.lower(), "--reason", "superseded")
    organization("revoke", "auditor", "panther1")
    organization("budget", "operator", "--period", "0")
    organization("budget", "treasurer", "--period", "0")
    organization("dismiss", "panther1")
    organization("members-only", "--off")
    organization("terms")
    followed, others = ("0x" + digit * 64 for digit in "56")
    organization("kind", "sweeping", "--judge", "auditor", "--rules", followed)
    organization("kind", "sweeping", "--judge", "auditor", "--rules", others)
    organization("retire-rules", "sweeping", others)
    assert "rules_not_current" in organization("retire-rules", "sweeping", others, status=1)
    by_people = {"kind": "sweeping", "rules_sha256": followed, "state": "newest"}
    listed = json.loads(organization("rules", "--json"))["rules"]
    assert by_people | {"open_tasks": 0, "installed": False} in listed
    assert {one["kind"] for one in listed if one["installed"]} == {"waste_disposal", "battery_charging"}
    assert followed in organization("rules") and followed in organization("show")
    organization("kind", "sweeping", "--disallow")
    organization("policy", "first_come")
    assert "superseded" in organization("devices")
    assert json.loads(organization("roots", "--json")) == {"roots": [], "total": 0}
    assert "root" in organization("roots")
    after = state()
    (sweeping,) = [one for one in after["kinds"] if one["kind"] == "sweeping"]
    assert sweeping.items() >= (rules | {"allowed": False}).items()
    same = ("policy", "members_only", "terms", "roles", "budgets")
    assert all(after[name] == before[name] for name in same)
    assert "kind_without_checks" in organization("kind", "sweeping", "--judge", "oracle", status=1)
    assert "invalid_request" in organization("kind", "sweeping", status=1)
    assert "invalid_request" in organization("policy", "chance", status=1)
    assert "unknown_participant" in organization("admit", "bob", status=1)
    assert "unknown_service" in organization("suspend", "12345", status=1)
    assert "unknown_service" in organization("reinstate", "12345", status=1)


def test_a_task_names_one_of_its_kinds_current_rules(up: Path) -> None:
    def shown() -> tuple[list[str], bool]:
        found = json.loads(rodeo(up, "kind", "show", "waste_disposal", "--json").stdout)
        return found["current_rules"], found["installed_is_current"]

    def change(*arguments: str) -> None:
        rodeo(up, "organization", arguments[0], "waste_disposal", *arguments[1:])

    post = ("task", "create", "waste_disposal", "--item-id", "item1", "--reward", "1", "--wait")
    (installed,), is_current = shown()
    assert is_current
    other, never = ("0x" + digit * 64 for digit in "59")
    change("kind", "--judge", "oracle", "--rules", other)
    assert shown() == ([installed, other], True)
    for named, kept in ((("--rules", installed), installed), ((), other)):
        task_id = str(json.loads(rodeo(up, *post, *named, "--json").stdout)["task_id"])
        assert json.loads(rodeo(up, "task", "show", task_id, "--json").stdout)["rules_sha256"] == kept
        rodeo(up, "task", "cancel", task_id)
    refused = rodeo(up, *post, "--rules", never, status=1).stderr
    assert all(one in refused for one in ("rules_not_current", never, installed, other))
    assert "--rules" in rodeo(up, *post, "--rules", "5", status=1).stderr
    change("retire-rules", installed)
    assert shown() == ([other], False)
    assert "not among them" in rodeo(up, "kind", "show", "waste_disposal").stdout
    change("kind", "--judge", "oracle", "--rules", installed)
    change("retire-rules", other)
    assert shown() == ([installed], True)


def test_services_and_wallets_are_listed(up: Path) -> None:
    services = rodeo(up, "service", "list").stdout
    assert "panther1" in services and "100 IEC" in services
    assert json.loads(rodeo(up, "wallet", "oracle", "--json").stdout)["balance_iec"] == "0"
    done = rodeo(up, "wallet", "bob", status=1)
    assert "bob" in done.stderr and "panther1" in done.stderr
