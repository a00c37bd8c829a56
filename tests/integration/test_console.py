"""The console as people and programs use it: a browser and a client in front of the whole organization."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from services.console.accounts import Accounts, accounts_path
from services.console.roles import Role
from tests.support.accessibility import everything_is_named, nothing_is_faint
from tests.support.browser import chromium, log_in, watch
from tests.support.site import RunningSite, write_site

PASSPHRASE = "correct horse battery"
WAIT_MS = 60_000
expect.set_options(timeout=WAIT_MS)
SITE = """clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = false
[[participants]]
name = "eva"
"""
PHOTO = Path(__file__).parents[1] / "unit" / "services" / "itrash" / "renderings" / "paper_1.jpg"


class Desk:
    """The console of a running site."""

    def __init__(self, running: RunningSite, browser: Browser) -> None:
        self.running = running
        self.browser = browser
        self.origin = str(running.status("console").details["http"])
        self.accounts = Accounts(accounts_path(running.site), running.site.console)
        everything = [role for role in Role if role is not Role.EXECUTOR]
        self.accounts.add_user("ada", PASSPHRASE, everything)
        self.accounts.add_user("reader", PASSPHRASE, [])

    def page(self, user: str | None) -> Page:
        """A browser of its own, logged in as `user`."""
        page = self.browser.new_page(base_url=self.origin, viewport={"width": 1280, "height": 900})
        page.set_default_timeout(WAIT_MS)
        page.goto("/")
        if user is not None:
            log_in(page, user, PASSPHRASE)
            expect(page.get_by_role("heading", name="Overview")).to_be_visible(timeout=WAIT_MS)
        return page

    def client(self, user: str | None) -> httpx.Client:
        """A program with a token of `user`."""
        token = "none" if user is None else self.accounts.issue_token(user, "test")
        headers = {"Authorization": f"Bearer {token}"}
        return httpx.Client(base_url=f"{self.origin}/api", headers=headers, timeout=60)


def click_map(page: Page, x_m: float, y_m: float) -> None:
    """Click the floor at this place of the map frame."""
    page.locator(".lab-map .floor").wait_for()
    x, y = page.evaluate(
        """([x, y]) => { const svg = document.querySelector('.lab-map svg');
        svg.scrollIntoView({block: 'center'});
        const p = new DOMPoint(x, -y).matrixTransform(svg.getScreenCTM()); return [p.x, p.y]; }""",
        [x_m, y_m],
    )
    page.mouse.click(x, y)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Desk]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("console"), chain_backend, SITE))
    running.start("router", "chain", "console", ready=False)
    running.deploy_contracts()
    running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
    running.wait_ready("console")
    with chromium() as browser:
        yield Desk(running, browser)
    running.stop()


PAGES = ("/", "/tasks", "/tasks/new", "/tasks/1", "/services", "/treasury", "/work", "/operator", "/accounts")


@pytest.mark.timeout(900)
def test_a_task_posted_by_clicking_the_map_is_watched_until_it_is_paid_and_replayed(desk: Desk) -> None:
    page = desk.page("ada")
    faults = watch(page, desk.origin)
    page.get_by_role("link", name="Post a task").click()
    expect(page.get_by_role("heading", name="Post a task")).to_be_visible()
    place = desk.running.site.items[0].pose

    click_map(page, 3.2, 2.9)
    expect(page.get_by_text("desk2 stands there")).to_be_visible()
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("dialog")).to_have_count(0)

    click_map(page, place.x_m, place.y_m)
    expect(page.get_by_text("stands there")).to_have_count(0)
    expect(page.get_by_label("East, x (m)")).to_have_value(re.compile(rf"{place.x_m:.1f}\d?"))
    page.get_by_role("button", name="Review and post").click()
    page.get_by_role("dialog").get_by_role("button", name="Pay 100 IEC into escrow").click()

    expect(page.get_by_role("heading", name=re.compile(r"Task \d+ · waste disposal"))).to_be_visible()
    task_id = int(page.url.rsplit("/", 1)[-1])
    expect(page.locator(".page-head .badge")).to_have_text("settled", timeout=8 * WAIT_MS)
    report = page.get_by_role("region", name="Oracle's report")
    expect(report.get_by_text("accepted").first).to_be_visible()
    assert report.get_by_role("row").count() > 10
    expect(report.locator("tbody .badge", has_text="failed")).to_have_count(0)

    with page.expect_download() as download:
        page.get_by_role("link", name="Download the proof").click()
    task = desk.running.bus.query(f"rodeo/lab/state/task/{task_id}")
    assert desk.running.site.store_url in task["proof_uri"]
    assert download.value.path().read_bytes()[:5] == b"\x89MCAP"

    page.get_by_role("button", name="Replay the recording").click()
    slider = page.get_by_role("slider", name="Time in the recording")
    expect(slider).to_be_visible()
    robot = page.locator(".lab-map .robot .moving").first
    start = robot.get_attribute("style")
    slider.fill(slider.get_attribute("max") or "")
    expect(robot).not_to_have_attribute("style", start or "")
    said = page.get_by_role("list", name="What was recorded")
    expect(said.get_by_text("Task settled")).to_have_count(0)  # the recording ends before
    expect(said.get_by_text("Bin: it fell into yellow")).to_be_visible()
    assert faults == []
    page.close()


def test_a_person_does_a_task_hands_in_a_photo_and_is_paid_when_an_auditor_approves(desk: Desk) -> None:
    desk.accounts.add_user("eva", PASSPHRASE, [Role.EXECUTOR], "eva")
    with desk.client("ada") as ada, desk.client("eva") as eva:
        for client, action, request in (
            (ada, "allow-kind", {"kind": "wheel_cleaning", "review": "auditor"}),
            (eva, "register-service", {"kind": "wheel_cleaning", "price_iec": "5", "participant": "eva"}),
            (
                ada,
                "post-task",
                {"kind": "wheel_cleaning", "reward_iec": "6", "description": "Clean my wheels"},
            ),
        ):
            reply = client.post(f"/actions/{action}", json=request)
            assert reply.status_code == 200, reply.text
        task_id = reply.json()["task_id"]
        forbidden = eva.post("/actions/register-service", json={"kind": "wheel_cleaning", "price_iec": "1"})
        assert (forbidden.status_code, forbidden.json()["code"]) == (403, "forbidden")

    person = desk.page("eva")
    person.get_by_role("link", name="My work").click()
    person.get_by_role("button", name=f"Accept task {task_id}").click()
    expect(person.get_by_text(f"Task {task_id} is yours to do")).to_be_visible()
    person.get_by_role("button", name=f"Hand in task {task_id}").click()
    person.get_by_label("What did you do?").fill("Washed all four wheels")
    person.locator("input[type=file]").set_input_files(PHOTO)
    expect(person.get_by_text("1 photo added")).to_be_visible()
    person.get_by_role("button", name="Review").click()
    person.get_by_role("button", name="Seal and hand in").click()
    handed_in = person.get_by_role("region", name="Handed in")
    expect(handed_in.get_by_text("waiting for the verdict")).to_be_visible()

    auditor = desk.page("ada")
    auditor.get_by_role("link", name="My work").click()
    auditor.get_by_role("button", name=f"Judge task {task_id}").click()
    expect(auditor.get_by_text("“Washed all four wheels”")).to_be_visible()
    expect(auditor.get_by_role("img", name="Photo 1 of the work")).to_be_visible()
    auditor.get_by_label("Why?").fill("They shine")
    auditor.get_by_role("button", name="Approve").click()
    auditor.get_by_role("dialog", name="Approve this work?").get_by_role("button", name="Approve").click()

    expect(handed_in.get_by_text("paid 5 IEC")).to_be_visible()
    expect(person.locator(".tile .value").first).to_have_text("5 IEC")
    person.close()
    auditor.close()


def test_every_control_has_a_name_and_every_text_can_be_read_in_light_and_dark(desk: Desk) -> None:
    page = desk.page("ada")
    for path in PAGES:
        page.goto(path)
        expect(page.locator(".page h1")).to_have_count(1)
        expect(page.get_by_text("Loading …")).to_have_count(0)
        everything_is_named(page)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            expect(page.locator("body")).to_have_class(re.compile(f"body--{scheme}"))
            nothing_is_faint(page)
    page.close()


def test_nobody_gets_in_without_the_passphrase_and_a_browser_that_tries_is_slowed_down(desk: Desk) -> None:
    page = desk.page(None)
    assert page.url == f"{desk.origin}/login?next=/"
    log_in(page, "ada", "wrong passphrase")
    expect(page.get_by_role("alert")).to_have_text("The name or the passphrase is wrong. Try again.")
    with httpx.Client(base_url=desk.origin, headers={"Origin": desk.origin}, timeout=60) as client:
        tries = [
            client.post("/login", data={"name": "eve", "passphrase": f"guess number {n}"}).status_code
            for n in range(7)
        ]
    assert tries == [401] * 5 + [429] * 2
    log_in(page, "ada", PASSPHRASE)
    expect(page.get_by_role("heading", name="Overview")).to_be_visible()
    page.close()


def test_who_has_no_role_may_look_and_is_refused_whatever_they_try(desk: Desk) -> None:
    page = desk.page("reader")
    expect(page.get_by_role("link", name="Post a task")).to_have_count(0)
    page.goto("/tasks/new")
    expect(page.get_by_text("needs the role operator")).to_be_visible()
    expect(page.get_by_role("button", name="Review and post")).to_have_count(0)
    page.close()
    task: dict[str, Any] = {"kind": "waste_disposal", "reward_iec": "1", "params": {}}
    with desk.client("reader") as client:
        assert client.get("/tasks").status_code == 200
        refused = client.post("/actions/post-task", json=task)
        assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
    with desk.client(None) as client:
        assert client.get("/tasks").status_code == 401


def test_taking_a_role_takes_it_from_a_page_that_is_open_too(desk: Desk) -> None:
    desk.accounts.add_user("bob", PASSPHRASE, [Role.OPERATOR])
    page = desk.page("bob")
    page.get_by_role("link", name="Post a task").click()
    click_map(page, 2.0, 1.0)
    expect(page.get_by_label("East, x (m)")).to_have_value(re.compile(r"2\.0|1\.9"))
    desk.accounts.change_user("bob", [], None)
    page.get_by_role("button", name="Review and post").click()
    page.get_by_role("button", name="Pay 100 IEC into escrow").click()
    expect(page.get_by_text("This needs the role operator")).to_be_visible()
    page.close()


def test_a_session_that_was_ended_elsewhere_ends_at_the_next_click(desk: Desk) -> None:
    desk.accounts.add_user("carol", PASSPHRASE, [Role.OPERATOR])
    page = desk.page("carol")
    page.get_by_role("link", name="Post a task").click()
    expect(page.get_by_label("Reward (IEC)")).to_have_value("100")
    desk.accounts.set_passphrase("carol", "another passphrase")
    page.get_by_role("button", name="Review and post").click()
    expect(page.get_by_role("button", name="Log in")).to_be_visible()
    page.close()


def test_other_sites_can_neither_post_nor_listen_with_somebodys_cookie(desk: Desk) -> None:
    with httpx.Client(base_url=desk.origin, timeout=60) as client:
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
        connect(url, origin=Origin("http://evil.example"), additional_headers=cookie)
    assert refused.value.response.status_code == 403
    with connect(url, origin=Origin(desk.origin)) as stranger:
        assert str(stranger.recv(60)).startswith("0")
        stranger.send("40")
        assert stranger.recv(60) == '44{"message":"Implicit handshake failed"}'
        with pytest.raises(ConnectionClosed):
            stranger.recv(60)
