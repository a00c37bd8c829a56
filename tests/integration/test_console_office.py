"""The console without robots: who may do what, the organization's own affairs, what goes away under an open
page, and programs that send anything.

Router, chain, bridge and console are real; requests are made from the interface's own OpenAPI document, and
what fits it reaches the contracts.
"""

from __future__ import annotations

import csv
import re
import secrets
from collections.abc import Iterator
from contextlib import suppress
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
import schemathesis
from eth_account import Account
from hypothesis import HealthCheck, settings
from playwright.sync_api import Locator, Page, Route, expect
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.bus.seen import Seen, SightReport
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.events import ServiceRegistered
from rodeo.chain.deployment import Deployment
from rodeo.errors import BusError
from rodeo.lab.render import encode
from rodeo.money.currency import IEC
from rodeo.person.photos import keep
from rodeo.signing import keystores, possession, wallets
from rodeo.site.sections import LOCAL_CHAIN_ID
from rodeo_testing.waiting import HANG_S, wait_until
from services.console.rest import make_api
from tests.support.accessibility import tab_to
from tests.support.browser import chromium, log_in
from tests.support.console import PASSPHRASE, Desk, click_map, open_page, there
from tests.support.dao import Dao, founded
from tests.support.site import NewSite
from tests.support.views import logs_of

pytestmark = pytest.mark.long

SITE = """[[participants]]
name = "eva"
"""


PAGES = (
    "/",
    "/tasks",
    "/tasks/new",
    "/services",
    "/treasury",
    "/proposals",
    "/work",
    "/operator",
    "/accounts",
)


class Office(Desk):
    """The desk, and the organization behind it."""

    dao: Dao

    def cancel(self, task_id: int) -> None:
        """As soon as the bridge can be asked: it is ready before everybody knows where it is again."""

        def cancelled() -> bool:
            with suppress(BusError):
                # The same request twice is carried out once.
                self.dao.command(
                    "organization", "cancel_task", task_id=task_id, request_id=f"cancel-{task_id}"
                )
                return True
            return False

        wait_until(cancelled, lambda: self.running.log("bridge"))


@pytest.fixture(scope="module")
def desk(new_site: NewSite) -> Iterator[Office]:
    with founded(new_site(SITE), "console") as dao:
        dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        with chromium(three_d=False) as browser:
            desk = Office(dao.running, browser)
            desk.dao = dao
            desk.accounts.add_user("fuzzer", PASSPHRASE, list(Role), "organization")
            yield desk


def test_nobody_gets_in_without_the_passphrase_and_a_browser_that_tries_is_slowed_down(desk: Office) -> None:
    page = desk.page(None)
    assert page.url == f"{desk.origin}/login?next=/"
    log_in(page, "ada", "wrong passphrase")
    expect(page.get_by_role("alert")).to_have_text("The name or the passphrase is wrong. Try again.")
    with httpx.Client(base_url=desk.origin, headers={"Origin": desk.origin}, timeout=HANG_S) as client:
        tries = [
            client.post("/login", data={"name": "eve", "passphrase": f"guess number {n}"}).status_code
            for n in range(7)
        ]
    assert tries == [401] * 5 + [429] * 2
    log_in(page, "ada", PASSPHRASE)
    expect(page.get_by_role("heading", name="Overview")).to_be_visible()
    page.close()


def test_a_task_is_posted_cancelled_and_posted_again_with_the_keyboard_alone(desk: Office) -> None:
    page = desk.page(None)
    press = page.keyboard.press
    expect(page.get_by_label("Name")).to_be_focused()
    page.keyboard.type("ada")
    press("Tab")
    page.keyboard.type(PASSPHRASE)
    press("Enter")
    there(page, "Overview")
    tab_to(page, page.get_by_role("link", name="Skip to main content"))
    press("Enter")
    tab_to(page, page.get_by_role("link", name="Post a task"))
    press("Enter")
    there(page, "Post a task")
    expect(page.get_by_label("East, x (m)")).not_to_have_value("")
    for field, text in (
        ("East, x (m)", "2"),
        ("North, y (m)", "1"),
        ("Reward (IEC)", "0.125"),
        ("Time to do it (min)", "12"),
    ):
        tab_to(page, page.get_by_label(field))
        press("Control+A")
        page.keyboard.type(text)
    service = page.get_by_role("combobox", name="Service")
    tab_to(page, service)
    press("ArrowDown")
    expect(page.locator(".q-menu").get_by_role("option")).to_have_text(
        ["any service", "1: panther1, 100 IEC"]
    )
    page.keyboard.type("1")
    press("Enter")
    expect(page.get_by_text("This service costs 100 IEC")).to_be_visible()
    tab_to(page, page.get_by_role("checkbox", name="Queue it if every service costs more"))
    press("Space")
    for hint in ("This service", "The cheapest service", "stands there"):
        expect(page.get_by_text(hint)).to_have_count(0)

    review = page.get_by_role("button", name="Review and post")
    pay = page.get_by_role("button", name="Pay 0.125 IEC into escrow")
    tab_to(page, review)
    press("Enter")
    expect(pay).to_be_focused()
    expect(page.get_by_role("dialog")).to_contain_text("1: panther1, 100 IEC")
    # Until it has opened, Quasar lets Tab lead anywhere, and then brings the focus back.
    expect(page.locator(".q-dialog__inner--animating")).to_have_count(0)
    for _ in range(5):  # Tab leads to the browser's own controls and into the dialog, not behind it
        press("Tab")
        assert page.evaluate("document.activeElement.matches('body, [role=dialog] *')")
    press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(review).to_be_focused()
    press("Enter")
    expect(pay).to_be_focused()
    press("Enter")
    there(page, re.compile("^Task "))
    state = page.locator(".page-head .badge")
    expect(state).to_have_text("open")
    expect(page.get_by_text("Only service").locator("xpath=following-sibling::*[1]")).to_have_text("1")

    tab_to(page, page.get_by_role("button", name="Cancel"))
    press("Enter")
    expect(page.get_by_role("button", name="Cancel the task")).to_be_focused()
    press("Enter")
    expect(state).to_have_text("cancelled")
    tab_to(page, page.get_by_role("link", name="Post again"))
    press("Enter")
    there(page, "Post a task")
    expect(page.get_by_label("Reward (IEC)")).to_have_value("0.125")
    expect(page.get_by_label("Time to do it (min)")).to_have_value(re.compile(r"12(\.0+)?"))
    expect(page.get_by_label("North, y (m)")).to_have_value(re.compile(r"1(\.0+)?"))
    expect(service).to_have_value("1: panther1, 100 IEC")

    tab_to(page, page.get_by_role("link", name="Tasks", exact=True))
    press("Enter")
    there(page, "Tasks")
    tab_to(page, page.get_by_role("combobox", name="State"))
    press("ArrowDown")
    expect(page.get_by_role("option", name="cancelled")).to_be_visible()
    page.keyboard.type("c")
    press("Enter")
    expect(page.locator("tbody .badge").first).to_have_text("cancelled")
    expect(page.locator("tbody .badge", has_text="open")).to_have_count(0)
    tab_to(page, page.locator("tbody a").first)
    press("Enter")
    expect(state).to_have_text("cancelled")
    page.close()


def test_a_task_is_posted_for_a_provider_with_any_of_its_services(desk: Office) -> None:
    # The bridge lets a robot offer one service of a kind; the contracts know of no robots.
    client = ChainClient(desk.dao.site.chain.url, Deployment.load(desk.dao.site.data_dir, LOCAL_CHAIN_ID))
    robot, price = wallets.load(desk.dao.site, "panther1"), IEC.to_units(Decimal(90))
    call = client.calls.register_service("waste_disposal", price, 2**95, True, "")
    (second,) = [
        log.event.service_id
        for log in logs_of(client, client.send(robot, call))
        if isinstance(log.event, ServiceRegistered)
    ]
    # The form offers what the console has heard of, and an open list does not change.
    page = desk.page("ada", "/services")
    expect(row(page, "Services on offer", "90 IEC")).to_be_visible()
    open_page(page, "/tasks/new")
    page.get_by_label("Reward (IEC)").fill("0.25")
    page.get_by_role("combobox", name="Service").click()
    page.get_by_role("option", name=re.compile(r"any of panther1 \(\d services\)")).click()
    expect(page.get_by_text("The cheapest service of this provider costs 90 IEC")).to_be_visible()
    page.get_by_role("checkbox", name="Queue it if every service costs more").click()
    expect(page.get_by_text("The cheapest service")).to_have_count(0)
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("dialog")).to_contain_text("any of panther1")
    page.get_by_role("button", name="Pay 0.25 IEC into escrow").click()
    there(page, re.compile("^Task "))
    provider = page.get_by_text("Only provider").locator("xpath=following-sibling::*[1]")
    expect(provider).to_have_text("panther1")
    expect(page.locator(".page-head .badge")).to_have_text("open")
    desk.cancel(int(page.url.rsplit("/", 1)[1]))
    desk.dao.command("panther1", "update_service", service_id=second, state="retired")
    page.close()


def test_what_is_typed_before_a_page_listens_stays(desk: Office) -> None:
    page = desk.page("ada", "/tasks/new")
    for _ in range(3):
        page.goto("/tasks/new", wait_until="commit")
        page.get_by_label("Reward (IEC)").fill("0.25")
        there(page, "Post a task")
        # The server has heard of it, and has said all that it had to say.
        expect(page.get_by_text("The cheapest service of this kind costs")).to_be_visible()
        expect(page.get_by_label("Reward (IEC)")).to_have_value("0.25")
    page.close()


def test_the_focus_stays_on_a_button_that_is_drawn_again(desk: Office) -> None:
    desk.dao.command("organization", "allow_kind", kind="window_cleaning", judge="auditor")
    offer = {"kind": "window_cleaning", "price_iec": "1000", "description": "dear"}
    service_id = desk.dao.command("eva", "register_service", **offer)["service_id"]
    page = desk.page("ada", "/services")
    offered = row(page, "Services on offer", "dear")
    change = offered.get_by_role("button", name="Change service")
    tab_to(page, change)
    for price_iec in ("1001", "1002"):
        desk.dao.command("eva", "update_service", service_id=service_id, price_iec=price_iec)
        expect(offered).to_contain_text(f"{price_iec[0]},{price_iec[1:]} IEC")
        expect(change).to_be_focused()
    page.close()


def test_who_has_no_role_may_look_and_is_refused_whatever_they_try(desk: Office) -> None:
    page = desk.page("reader")
    expect(page.get_by_role("link", name="Post a task")).to_have_count(0)
    page.goto("/tasks/new")
    expect(page.get_by_text("You need the role operator")).to_be_visible()
    expect(page.get_by_role("button", name="Review and post")).to_have_count(0)
    page.close()
    task: dict[str, Any] = {"kind": "waste_disposal", "reward_iec": "1", "params": {}}
    with desk.client("reader") as client:
        assert client.get("/tasks").status_code == 200
        refused = client.post("/actions/post-task", json=task)
        assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
    with desk.client(None) as client:
        assert client.get("/tasks").status_code == 401


PHOTO = re.compile(r"^[0-9a-f]{64}\.png$")


def held_photo(page: Page) -> list[Route]:
    """The upload of a chosen photo, which the test lets continue: it is in the list once the page was asked
    anything else."""
    photo = {
        "name": "can.png",
        "mimeType": "image/png",
        "buffer": encode(np.zeros((8, 8, 3), np.uint8), ".png"),
    }
    held: list[Route] = []
    page.route("**/upload/*", lambda route: held.append(route))
    with page.expect_request("**/upload/*"):
        page.locator("input[type=file]").set_input_files(photo)
    return held


def test_a_photo_arrives_although_another_kind_is_shown_meanwhile(desk: Office) -> None:
    page = desk.page(desk.somebody(Role.OPERATOR), "/tasks/new")
    click_map(page, 2.0, 1.0)
    expect(page.get_by_text("whatever lies at the place")).to_be_visible()
    held = held_photo(page)
    choose(page, "Kind", "battery charging")
    with page.expect_response("**/upload/*"):
        held.pop().continue_()
    choose(page, "Kind", "waste disposal")
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("dialog").get_by_text(PHOTO)).to_be_visible()
    page.close()


def test_taking_a_role_takes_it_from_a_page_that_is_open_too(desk: Office) -> None:
    operator = desk.somebody(Role.OPERATOR)
    page = desk.page(operator, "/tasks/new")
    click_map(page, 2.0, 1.0)
    expect(page.get_by_label("East, x (m)")).to_have_value(re.compile(r"2\.0|1\.9"))
    expect(page.get_by_text("whatever lies at the place")).to_be_visible()
    held = held_photo(page)
    review = page.get_by_role("button", name="Review and post")
    review.click()
    expect(review).to_be_disabled()  # the photo is still on its way
    held.pop().continue_()
    expect(page.get_by_role("dialog").get_by_text(PHOTO)).to_be_visible()
    desk.accounts.change_user(operator, [], None)
    page.get_by_role("button", name="Pay 100 IEC into escrow").click()
    expect(page.get_by_text("This needs the role operator")).to_be_visible()
    page.close()


def test_a_session_that_was_ended_elsewhere_ends_at_the_next_click(desk: Office) -> None:
    operator = desk.somebody(Role.OPERATOR)
    page = desk.page(operator, "/tasks/new")
    desk.accounts.set_passphrase(operator, "another passphrase")
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("button", name="Log in")).to_be_visible()
    page.close()


def test_other_sites_can_neither_post_nor_listen_with_somebodys_cookie(desk: Office) -> None:
    with httpx.Client(base_url=desk.origin, timeout=HANG_S) as client:
        form = {"name": "ada", "passphrase": PASSPHRASE}
        assert client.post("/login", data=form).status_code == 403
        assert client.post("/login", data=form, headers={"Origin": "http://evil.example"}).status_code == 403
        entered = client.post("/login", data=form, headers={"Origin": desk.origin})
        assert entered.status_code == 303
        flags = entered.headers["set-cookie"].lower()
        assert "httponly" in flags and "samesite=strict" in flags
        assert client.get("/", headers={"Host": "evil.example"}).status_code == 421
        page = client.get("/", headers={"Accept": "text/html"})
        client_id = re.search(r"""client_id['"]:\s*['"]([0-9a-f-]{36})""", page.text)
        assert client_id is not None
        policy = page.headers["content-security-policy"]
        assert "script-src 'self' 'nonce-" in policy and "default-src 'none'" in policy
        cookie = {"Cookie": f"rodeo_session={client.cookies['rodeo_session']}"}
    url = f"{desk.origin.replace('http', 'ws')}/_nicegui_ws/socket.io/"
    url += f"?EIO=4&transport=websocket&client_id={client_id[1]}"
    with pytest.raises(InvalidStatus) as refused:
        connect(url, origin=Origin("http://evil.example"), additional_headers=cookie, open_timeout=HANG_S)
    assert refused.value.response.status_code == 403
    with connect(url, origin=Origin(desk.origin), open_timeout=HANG_S) as stranger:
        assert str(stranger.recv(60)).startswith("0")
        stranger.send("40")
        assert stranger.recv(60) == '44{"message":"Implicit handshake failed"}'
        with pytest.raises(ConnectionClosed):
            stranger.recv(60)


def row(page: Page, table: str, text: str) -> Locator:
    """The first line of the table that says so."""
    return page.get_by_role("table", name=table).get_by_role("row").filter(has_text=text).first


def choose(page: Page, label: str, option: str) -> None:
    page.get_by_role("combobox", name=label).click()
    page.get_by_role("option", name=option).click()


def answer(page: Page, button: str) -> None:
    """Press this in the dialog that is open, and see it go."""
    page.get_by_role("dialog").get_by_role("button", name=button).click()
    expect(page.get_by_role("dialog")).to_have_count(0)


def give(page: Page, command: str) -> None:
    """Review the form of a command that is open, and have it done."""
    page.get_by_role("dialog").get_by_role("button", name="Review").click()
    answer(page, command)


def test_a_service_is_offered_priced_paused_resumed_and_retired(desk: Office) -> None:
    page = desk.page("ada", "/services")
    page.get_by_role("button", name="Offer a service").click()
    page.get_by_label("Price (IEC)").fill("much")
    page.get_by_role("button", name="Review").click()
    page.get_by_role("button", name="Register service").click()
    expect(page.get_by_text("price: enter an amount of IEC, for example 12.5")).to_be_visible()
    page.get_by_label("Price (IEC)").fill("42")
    page.get_by_label("Description").fill("by hand")
    give(page, "Register service")
    offered = row(page, "Services on offer", "by hand")
    expect(offered.locator(".badge")).to_have_text("active")
    expect(offered).to_contain_text("42 IEC")

    def change(what: str) -> None:
        offered.get_by_role("button", name="Change service").click()
        page.get_by_role("menu").get_by_text(what).click()

    def update(state: str) -> None:
        change("Price, pause, resume or retire")
        choose(page, "State", state)
        page.get_by_role("dialog").get_by_role("button", name="Review").click()
        sure = expect(page.get_by_role("dialog").get_by_role("button", name="Update service"))
        red = re.compile("bg-negative")
        sure.to_have_class(red) if state == "retired" else sure.not_to_have_class(red)
        answer(page, "Update service")
        expect(offered.locator(".badge")).to_have_text(state)

    change("Price, pause, resume or retire")
    page.get_by_label("Price (IEC)").fill("43.5")
    give(page, "Update service")
    expect(offered).to_contain_text("43.5 IEC")
    update("paused")
    update("active")
    change("Suspend")
    answer(page, "Suspend service")
    expect(offered.locator(".badge")).to_have_text("suspended")
    change("Reinstate")
    answer(page, "Reinstate service")
    expect(offered.locator(".badge")).not_to_have_text("suspended")
    update("retired")
    expect(offered.get_by_role("button")).to_have_count(0)
    page.close()


def rules_as_auditor(page: Page, task_id: int, ruling: str, why: str, **more: str) -> Locator:
    """The dialog that asks the auditor whether it is sure, once the form is filled in."""
    open_page(page, "/work")
    page.get_by_role("button", name=f"Judge task {task_id}").click()
    choose(page, "Ruling", ruling)
    page.get_by_label("Why?").fill(why)
    if "fault" in more:
        choose(page, "Whose doing it is", more["fault"])
    if "pay" in more:
        page.get_by_label("Pay (IEC)").fill(more["pay"])
    page.get_by_role("button", name="Rule", exact=True).click()
    return page.get_by_role("dialog", name="Rule on this work?")


def test_an_auditor_pays_a_part_of_what_the_oracle_passed_on(desk: Office) -> None:
    task_id = desk.dao.post("120")
    desk.dao.prove(task_id)
    desk.dao.verdict(task_id, "undecided", "the verification hung twice")
    page = desk.page("ada", f"/tasks/{task_id}")
    expect(page.get_by_text("An auditor decides")).to_be_visible()
    stands = page.get_by_text(
        "passed on to the auditors: the verification hung twice; void unless one rules by"
    )
    expect(stands).to_be_visible()
    sure = rules_as_auditor(page, task_id, "accepted", "Half of it is there", pay="40.5")
    expect(sure.get_by_text("40.5 IEC")).to_be_visible()
    sure.get_by_role("button", name="Rule").click()
    open_page(page, f"/tasks/{task_id}")
    expect(page.get_by_text("Verdict: accepted by an auditor")).to_be_visible()
    agreement = page.get_by_role("region", name="Agreement")
    expect(agreement.get_by_text("40.5 IEC")).to_be_visible()
    expect(agreement.get_by_text("79.5 IEC")).to_be_visible()
    task = desk.dao.task(task_id)
    assert (task["state"], task["paid_iec"], task["refunded_iec"]) == ("settled", "40.5", "79.5")
    page.close()


def test_a_void_task_says_whose_doing_it_was(desk: Office) -> None:
    task_id = desk.dao.post("120")
    desk.dao.prove(task_id)
    desk.dao.verdict(task_id, "undecided", "no place has these coordinates")
    page = desk.page("ada", "/work")
    why = {"fault": "the creator's doing"}
    sure = rules_as_auditor(page, task_id, "void", "The door was locked", **why)
    expect(sure.get_by_text("the creator's doing")).to_be_visible()
    sure.get_by_role("button", name="Rule").click()
    desk.dao.wait_for(lambda: desk.dao.task(task_id)["state"] == "failed", "the ruling")
    task = desk.dao.task(task_id)
    assert (task["verdict"], task["fault"], task["refunded_iec"]) == ("void", "creator", "120")
    open_page(page, f"/tasks/{task_id}")
    tries = page.get_by_role("table", name="Attempts at this task")
    word = "Void, the creator's doing, by the auditor organization (a person): “The door was locked”"
    expect(tries.get_by_text(word)).to_be_visible()
    open_page(page, "/services")
    expect(page.get_by_text(re.compile(r"\d+ the creator's doing")).first).to_be_visible()
    page.close()


def test_an_administrator_changes_the_rules_of_a_kind(desk: Office) -> None:
    def current() -> list[str]:
        kinds = {one["kind"]: one for one in desk.dao.state("organization")["kinds"]}
        return list(kinds["waste_disposal"]["rules_sha256"])

    installed, *before = current()
    other = "0x" + secrets.token_hex(32)
    page = desk.page("ada", "/services")
    shown = row(page, "Kinds of work", "Waste disposal")

    def change(what: str) -> None:
        shown.get_by_role("button", name="Change waste disposal").click()
        page.get_by_role("menu").get_by_text(what).click()

    change("Judge, times and rules")
    expect(page.get_by_label("Judge", exact=True)).to_have_value("oracle")
    page.get_by_label("Rules (0x…)").fill(other)
    give(page, "Allow kind")
    expect(shown.get_by_text(other[:10])).to_be_visible()
    assert current() == [installed, *before, other]
    open_page(page, "/tasks/new")
    page.get_by_label("Reward (IEC)").fill("0.25")
    expect(page.get_by_text("The cheapest service")).to_be_visible()
    page.get_by_role("checkbox", name="Queue it if every service costs more").click()
    expect(page.get_by_text("The cheapest service")).to_have_count(0)
    choose(page, "Judged by the rules", installed[:10])
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("dialog").get_by_text(installed)).to_be_visible()
    page.get_by_role("button", name="Pay 0.25 IEC into escrow").click()
    there(page, re.compile("^Task "))
    task_id = int(page.url.rsplit("/", 1)[-1])
    assert desk.dao.task(task_id)["rules_sha256"] == installed
    desk.dao.command("organization", "cancel_task", task_id=task_id)
    open_page(page, "/services")
    change("Retire rules")
    choose(page, "Rules", other[:10])
    give(page, "Retire rules")
    expect(shown.get_by_text(other[:10])).to_have_count(0)
    assert current() == [installed, *before]
    page.close()


def test_members_come_and_go_and_keys_sign_until_they_are_revoked(desk: Office) -> None:
    page = desk.page("ada", "/services")
    eva = row(page, "Participants", "eva")
    for what, word, is_member in (
        ("Make somebody a member", "Admit", True),
        ("End a membership", "Dismiss", False),
    ):
        page.get_by_role("button", name="Other commands").click()
        choose(page, "What", what)
        page.get_by_role("button", name="Go on").click()
        page.get_by_label("Account").fill("eva")
        page.get_by_role("button", name="Review").click()
        page.get_by_role("button", name=word, exact=True).click()
        expect(page.get_by_role("dialog")).to_have_count(0)
        shown = expect(eva.get_by_text("member"))
        shown.to_be_visible() if is_member else shown.to_have_count(0)

    account, dao = Account.create(), desk.dao
    key = account.address
    chain = queries.ask(dao.running.bus, dao.site.org, queries.CHAIN)
    owner = keystores.address(dao.site, "eva")
    agreed = possession.sign(account, owner, 0, chain.chain_id, chain.contracts.device_registry)
    page.get_by_role("button", name="Register a key").click()
    for label, said in (("Device", key), ("Signature", agreed), ("Name", "panther9"), ("Role", "robot")):
        page.get_by_role("dialog").get_by_label(label, exact=True).fill(said)
    for owner in ("nobody", "eva"):
        page.get_by_role("dialog").get_by_label("Owner", exact=True).fill(owner)
        page.get_by_role("button", name="Review").click()
        page.get_by_role("button", name="Register device").click()
        if owner == "nobody":
            expect(page.get_by_text("Participants are listed under Services")).to_be_visible()
    expect(page.get_by_role("dialog")).to_have_count(0)
    device = row(page, "Device keys", key[:10])
    device.get_by_role("button", name="Revoke").click()
    choose(page, "Reason", "Compromised")
    page.get_by_role("button", name="Review").click()
    page.get_by_role("button", name="Revoke device").click()
    expect(device.locator(".badge")).to_have_text("compromised")
    page.close()


def test_money_goes_into_the_treasury_and_out_of_it_and_the_chart_and_the_file_tell_why(desk: Office) -> None:
    page = desk.page("ada", "/treasury")
    transfers = page.get_by_role("table", name="Transfers, newest first")
    for button, amount, to in (("Deposit", "12", None), ("Withdraw", "7.5", "eva")):
        page.get_by_role("button", name=button, exact=True).click()
        page.get_by_label("Amount (IEC)").fill(amount)
        if to is not None:
            page.get_by_role("dialog").get_by_label("To", exact=True).fill(to)
        page.get_by_role("button", name="Review").click()
        page.get_by_role("button", name=f"{button} {amount} IEC").click()
        expect(page.get_by_role("dialog")).to_have_count(0)
        expect(transfers.get_by_role("row").nth(1)).to_contain_text(amount)
    expect(page.get_by_text("EUR/kWh").first).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("link", name="CSV", exact=True).click()
    newest, before, *_ = csv.DictReader(download.value.path().read_text().splitlines())
    assert (newest["change_iec"], newest["to"], newest["why"]) == (
        "-7.5",
        "eva",
        "Withdrawal from the treasury",
    )
    assert (before["change_iec"], before["why"]) == ("12", "Deposit into the treasury")
    series = page.evaluate(
        """() => { const id = document.querySelector('[aria-label^="Balance over"]').id.slice(1);
        const { series } = getElement(Number(id)).chart.getOption();
        return Object.fromEntries(series.map((one) => [one.name, one.data])); }"""
    )
    assert series["Received"][-1]["name"] == "Deposit into the treasury: +12 IEC"
    assert series["Paid"][-1]["name"] == "Withdrawal from the treasury: -7.5 IEC"
    assert all(price in (0.24, 0.34) for _, price in series["Electricity"])
    page.close()


def test_the_treasury_shows_what_everybody_earned_and_spent_by_week(desk: Office) -> None:
    task_id = desk.dao.post(reward_iec="100")
    desk.dao.prove(task_id)
    desk.dao.judge(task_id, accepted=True)
    page = desk.page("ada", "/treasury")
    lines = page.get_by_role("table", name="Earned and spent, the newest week first")
    done = lines.get_by_role("row").filter(has_text="panther1").filter(has_text="waste disposal")
    expect(done.first).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("link", name="Earnings as CSV").click()
    rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    earned = [one for one in rows if one["participant"] == "panther1" and int(one["done"])]
    assert earned and float(earned[0]["earned_iec"]) >= 100 and int(earned[0]["gas"]) > 0
    expect(done.first).to_contain_text(f"{float(earned[0]['earned_iec']):g} IEC")
    series = page.evaluate(
        """() => { const id = document.querySelector('[aria-label^="Earned and spent"]').id.slice(1);
        const { series } = getElement(Number(id)).chart.getOption();
        return series.map((one) => [one.name, one.data]); }"""
    )
    assert any(name == "panther1" and max(data) >= 100 for name, data in series)
    page.close()


def test_a_token_is_shown_once_and_works_until_it_is_revoked(desk: Office) -> None:
    page = desk.page(desk.somebody(), "/accounts")
    page.get_by_role("button", name="New token").click()
    page.get_by_label("What is it for?").fill("a program")
    page.get_by_role("button", name="Make it").click()
    token = page.get_by_text(re.compile("^rodeo_")).inner_text()
    page.get_by_role("button", name="I have it").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    open_page(page, "/accounts")
    assert token not in page.content()

    def asked() -> int:
        header = {"Authorization": f"Bearer {token}"}
        return httpx.get(f"{desk.origin}/api/tasks", headers=header, timeout=HANG_S).status_code

    assert asked() == 200
    page.get_by_role("button", name="Revoke a program").click()
    expect(page.get_by_text("You have no tokens.")).to_be_visible()
    assert asked() == 401
    page.close()


def test_an_administrator_makes_an_account_which_its_owner_makes_their_own(desk: Office) -> None:
    name = f"dan-{secrets.token_hex(4)}"
    page = desk.page("ada", "/accounts")
    page.get_by_role("button", name="New account").click()
    page.get_by_label("Name").fill(name)
    page.get_by_label("First passphrase").fill("first passphrase")
    choose(page, "Roles", "auditor")
    page.keyboard.press("Escape")
    answer(page, "Make it")
    expect(row(page, "Accounts", name)).to_contain_text("auditor")

    own = desk.browser.new_page(base_url=desk.origin)
    own.set_default_timeout(1e3 * HANG_S)
    own.goto("/accounts")
    log_in(own, name, "first passphrase")
    own.get_by_role("button", name="Set a new one").click()
    own.get_by_label("New passphrase").fill("second passphrase")
    own.get_by_label("Current passphrase").fill("not the first one")
    own.get_by_role("button", name="Set it").click()
    expect(own.get_by_text("The current passphrase is wrong")).to_be_visible()
    own.get_by_label("Current passphrase").fill("first passphrase")
    own.get_by_role("button", name="Set it").click()
    log_in(own, name, "second passphrase")
    expect(own.get_by_role("heading", name="Overview")).to_be_visible()

    row(page, "Accounts", name).get_by_role("button", name=f"Change {name}").click()
    page.get_by_role("menu").get_by_text("Disable").click()
    answer(page, "Disable it")
    own.get_by_role("button", name="Light or dark").click()
    expect(own.get_by_role("button", name="Log in")).to_be_visible()
    own.close()
    page.close()


def test_no_page_holds_a_secret_and_an_address_without_a_page_says_so(desk: Office) -> None:
    site = desk.running.site
    names = [*keystores.wallet_names(site), *keystores.device_names(site)]
    keys = [wallets.load(site, name).key.hex().removeprefix("0x") for name in names]
    task_id = desk.dao.post("1", allow_wait=True)
    page = desk.page("ada")
    (cookie,) = page.context.cookies()
    for path in (*PAGES, f"/tasks/{task_id}"):
        open_page(page, path)
        shown = page.content().lower()
        found = [text for text in (*keys, PASSPHRASE, "argon2", cookie["value"].lower()) if text in shown]
        assert found == [], path
    for path in ("/nothing", "/tasks/nothing"):
        page.goto(path)
        expect(page.get_by_text("This address has no page")).to_be_visible()
    page.goto("/tasks/999999")
    expect(page.get_by_text("There is no task 999999")).to_be_visible()
    expect(page.get_by_role("heading", level=1, name="Task 999999")).to_be_visible()
    expect(page.get_by_text("Loading …").first).to_be_hidden()
    desk.cancel(task_id)
    page.close()


@pytest.mark.parametrize("process", ["bridge", "router", "console"])
def test_an_open_page_says_that_it_is_not_current_and_recovers_by_itself(desk: Office, process: str) -> None:
    task_id = desk.dao.post("1", allow_wait=True)
    page = desk.page("ada", f"/tasks/{task_id}")
    state = page.locator(".page-head .badge")
    expect(state).to_have_text("open")
    told = page.get_by_text("Connection lost" if process == "console" else "This page is not current")
    desk.running.kill(process)
    expect(told.first).to_be_visible()

    desk.running.start(process, ready=False)
    desk.running.wait_for_status("bridge", lambda status: status.ready)
    desk.cancel(task_id)
    expect(state).to_have_text("cancelled")
    expect(told).to_be_hidden()
    page.close()


# Made here, and not asked of the process, so that each of its operations is a test of its own.
DOCUMENT = make_api(SimpleNamespace(queries=None)).openapi()
# A stream has no end: tests/unit/services/console/test_events.py reads it.
SCHEMA = schemathesis.openapi.from_dict(DOCUMENT).exclude(path="/events")
# One case for each limit of each field is a thousand requests; chance finds its way with fewer.
SCHEMA.config.phases.coverage.enabled = False


def test_the_process_describes_itself_with_this_document(desk: Office) -> None:
    assert httpx.get(f"{desk.origin}/api/openapi.json", timeout=HANG_S).json()["paths"] == DOCUMENT["paths"]


@SCHEMA.parametrize()
@settings(max_examples=3, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_whatever_the_document_allows_or_forbids_gets_a_documented_answer(
    case: schemathesis.Case, desk: Office
) -> None:
    # What fits may be refused by the organization, a 0 is as good as false, and 503 and 504 are promised
    # where the bridge is away or too slow.
    answer = case.call_and_validate(
        base_url=f"{desk.origin}/api",
        # With a token of its own: one of the requests is to revoke some.
        headers={"Authorization": f"Bearer {desk.accounts.issue_token('fuzzer', 'fuzz')}"},
        timeout=HANG_S,
        excluded_checks=[positive_data_acceptance, negative_data_rejection, not_a_server_error],
    )
    assert answer.status_code not in (500, 501, 502), answer.text


def test_what_a_robot_has_seen_is_confirmed_corrected_or_dismissed_with_a_click(desk: Office) -> None:
    bus, site = desk.running.bus, desk.dao.site
    photo = keep(site, encode(np.full((48, 64, 3), 128, np.uint8), ".jpg"))
    robot = Seen(bus, site.org, "panther1")
    desk.dao.set_clock(desk.dao.state("chain")["time_s"] + 60)
    page = desk.page("ada")
    for number, x_m in enumerate((1.0, 2.0), start=1):
        size_m = [0.12, 0.07, 0.07]
        robot.report(SightReport(kind="waste_disposal", x_m=x_m, y_m=1.2, size_m=size_m, photo=photo))
        # The page hears of it by itself.
        expect(page.get_by_role("listitem", name=f"Thing {number}")).to_contain_text(f"{x_m:.2f} m east")
    expect(page.get_by_text("Robots have seen 2 things on the floor")).to_be_visible()
    first, second = (page.get_by_role("listitem", name=f"Thing {number}") for number in (1, 2))
    second.get_by_role("button", name="Correct").click()
    page.get_by_role("button", name="Keep").click()
    expect(second).to_contain_text("ada: cardboard")
    second.get_by_role("button", name="Dismiss").click()
    expect(second).to_have_count(0)

    first.get_by_role("link", name="Confirm").click()
    there(page, "Post a task")
    expect(page.get_by_label("East, x (m)")).to_have_value(re.compile(r"1(\.0+)?"))
    expect(page.get_by_alt_text("The photo of what lies there")).to_be_visible()
    page.get_by_role("button", name="Without this photo").click()
    expect(page.get_by_alt_text("The photo of what lies there")).to_have_count(0)
    page.reload()
    there(page, "Post a task")
    expect(page.get_by_alt_text("The photo of what lies there")).to_be_visible()
    page.get_by_role("button", name="Review and post").click()
    page.get_by_role("button", name="Pay 100 IEC into escrow").click()
    there(page, re.compile("^Task "))
    task_id = int(page.url.rsplit("/", 1)[1])
    (thing,) = robot.things()
    assert (thing.state, thing.task_id) == ("posted", task_id)
    assert [one.what for one in thing.said] == ["confirmed"]
    desk.dao.command("panther1", "abandon_task", task_id=task_id, attempt=1)
    desk.cancel(task_id)
    wait_until(lambda: robot.things() == [])
    page.close()
