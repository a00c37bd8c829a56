"""The console in front of the whole organization: people post work, see robots do it, and order them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

import pytest
from playwright.sync_api import Page, expect

from rodeo.person.photo_code import photo_code
from rodeo_testing.recordings import RENDERINGS
from tests.support.accessibility import axe_finds_nothing, everything_is_named, nothing_is_faint
from tests.support.browser import chromium, watch
from tests.support.console import WAIT_MS, Desk, click_map, open_page
from tests.support.dao import Dao
from tests.support.site import NewSite, RunningSite

SITE = """clock.speed = 20
clock.idle_speed = 40
agent.explore_when_idle = false
people.min_window_s = 900
[[participants]]
name = "eva"
"""
PHOTO = RENDERINGS / "paper_1.jpg"


@pytest.fixture(scope="module")
def desk(new_site: NewSite) -> Iterator[Desk]:
    with RunningSite(new_site(SITE)) as running:
        running.start_founded("console", ready=False)
        running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
        running.wait_ready("console")
        with chromium() as browser:
            yield Desk(running, browser)


WITHOUT_3D = """const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...how) {
  return kind.startsWith("webgl") ? null : get.call(this, kind, ...how); };"""
"""The processor draws the views, and takes most of the time of tests that do not look at them."""
PAGES = (
    "/",
    "/tasks",
    "/tasks/new",
    "/tasks/1",
    "/replay?left=1",
    "/services",
    "/treasury",
    "/proposals",
    "/work",
    "/operator",
    "/accounts",
)


@pytest.mark.long
def test_a_task_posted_by_clicking_the_map_is_watched_until_it_is_paid_and_replayed(desk: Desk) -> None:
    page = desk.page("ada")
    faults = watch(page, desk.origin)
    page.get_by_role("link", name="Post a task").click()
    expect(page.get_by_role("heading", name="Post a task")).to_be_visible()
    place = desk.running.site.items[0].pose

    for kind, name in (("bin", "itrash"), ("dock", "dock1")):
        expect(page.locator(f".lab-map .{kind} text")).to_have_text(name)
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
    expect(page.locator(".page-head .badge")).to_have_text("settled")
    report = page.get_by_role("region", name="Oracle's report")
    expect(report.get_by_text("accepted").first).to_be_visible()
    told = report.get_by_text(re.compile(r"^(\d\d) of \1 passed; nearest to its limit: "))
    expect(told.first).to_be_visible()
    groups = report.locator("summary strong")
    expect(groups).to_have_text(["Who and when", "Motion", "Grasp and carry", "Bin", "File"])
    held = report.get_by_role("listitem").filter(has_text="gripper force")
    expect(held).to_have_count(0)
    groups.nth(2).click()
    expect(held).to_contain_text("at most 5.25 N")

    with page.expect_download() as download:
        page.get_by_role("link", name="Download the proof").click()
    task = desk.running.bus.query(f"rodeo/lab/state/task/{task_id}")
    assert desk.running.site.store_url in task["proof_uri"]
    assert download.value.path().read_bytes()[:5] == b"\x89MCAP"

    view = page.locator(".lab-scene")
    view.scroll_into_view_if_needed()
    expect(view.locator("canvas")).to_be_visible()
    page.get_by_role("button", name="Replay the recording").click()
    slider = page.get_by_role("slider", name="Time in the recording")
    expect(slider).to_be_visible()
    robot = page.locator(".lab-map .robot .moving").first
    start, drawn = robot.get_attribute("style"), view.get_attribute("data-drawn")
    expect(page.get_by_role("img", name="What itrash's camera saw")).to_have_count(0)
    slider.fill(slider.get_attribute("max") or "")
    expect(robot).not_to_have_attribute("style", start or "")
    expect(page.get_by_role("img", name="What itrash's camera saw")).to_be_visible()
    view.scroll_into_view_if_needed()
    expect(view).not_to_have_attribute("data-drawn", drawn or "")
    said = page.get_by_role("list", name="What was recorded")
    expect(said.get_by_text("Task settled")).to_have_count(0)  # the recording ends before
    expect(said.get_by_text("Bin: it fell into yellow")).to_be_visible()
    expect(page.get_by_role("img", name="grip force over time")).to_be_visible()
    page.get_by_role("button", name=re.compile("lifted: .*grasp.* passed")).click()
    expect(said.locator(".past").last).to_contain_text("Lifted")

    open_page(page, "/replay")
    page.locator("input[type=file]").last.set_input_files(
        {"name": "found.mcap", "mimeType": "", "buffer": download.value.path().read_bytes()}
    )
    dropped = page.get_by_role("region", name="Right")
    expect(dropped.get_by_text("found.mcap: sealed; nobody has checked it")).to_be_visible()
    expect(dropped.get_by_role("slider", name="Time in the recording")).to_be_visible()
    page.get_by_label("Task, or task.attempt").first.fill(f"{task_id}.1")
    page.get_by_role("button", name="Show on the left").click()
    expect(page.get_by_role("slider", name="Time in the recording")).to_have_count(2)
    assert faults == []
    item = task["params"]["item_id"]
    open_page(page, "/tasks/new")
    expect(page.get_by_text(f"{item} lies in itrash, yellow")).to_be_visible()
    page.get_by_role("combobox", name="Item").click()
    expect(page.get_by_role("option", name=re.compile("^item"))).to_have_count(2)
    expect(page.get_by_role("option", name=item)).to_have_count(0)

    open_page(page, "/")
    can_be_moved_without_a_mouse(page)
    robot_row = page.get_by_role("table", name="Robots").get_by_role("row").filter(has_text="panther1")
    expect(robot_row).to_contain_text("%")
    happened = page.get_by_role("region", name="Events and alarms")
    paid = happened.get_by_role("listitem").filter(has_text=f"Task {task_id}: 100 IEC paid")
    for new in (1, 0):
        happened.get_by_label("Task").fill(str(task_id))
        expect(paid).to_have_count(1)
        expect(paid.get_by_text("new", exact=True)).to_have_count(new)
        if new:
            happened.get_by_role("button", name="Mark as read").click()
            expect(paid.get_by_text("new", exact=True)).to_have_count(0)
            open_page(page, "/")
    page.close()


def can_be_moved_without_a_mouse(page: Page) -> None:
    """The overview's map zooms, moves and follows the robot."""
    camera = page.locator(".lab-map .camera")
    whole, middle = camera.get_attribute("style") or "", "translate(3.5px, -2.5px)"
    assert middle in whole
    tools = page.locator(".lab-map .lab-tools")
    tools.get_by_label("Follow").select_option("panther1")
    expect(camera).to_have_attribute("style", re.compile(r"scale\(3\)"))
    page.get_by_role("group", name=re.compile("^Map: ")).focus()
    for key, becomes in (("-", r"scale\(2\)"), ("ArrowUp", r"scale\(2\)"), ("0", r"scale\(1\)")):
        before = camera.get_attribute("style") or ""
        page.keyboard.press(key)
        expect(camera).not_to_have_attribute("style", before)
        expect(camera).to_have_attribute("style", re.compile(becomes))
    expect(camera).to_have_attribute("style", whole)
    names = page.locator(".lab-map .bin text")
    tools.get_by_text("Layers").click()
    tools.get_by_label("Names").uncheck()
    expect(names).to_be_hidden()
    tools.get_by_label("Names").check()
    expect(names).to_be_visible()
    expect(page.locator(".lab-map .trail").first).to_be_attached()


@pytest.mark.long
def test_a_person_does_a_task_hands_in_a_photo_and_is_paid_when_an_auditor_approves(desk: Desk) -> None:
    with desk.client("ada") as ada, desk.client("eva") as eva:
        for client, action, request in (
            (ada, "allow-kind", {"kind": "wheel_cleaning", "judge": "auditor"}),
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

    paid_iec = Dao(desk.running).balances()["eva"] + 5
    person = desk.page("eva", "/work")
    todo = person.get_by_role("region", name="To do")
    expect(todo.get_by_text("Clean my wheels · pays 5 IEC · due by")).to_be_visible()
    # Where the simulation is as fast as the wall clock, there is one time to tell.
    left = re.compile(r"of site time left, .* on the wall clock at the present speed|\d (s|min) left")
    expect(todo.get_by_text(left)).to_be_visible()
    expect(person.get_by_text("its time, and with it every window, runs up to 40 times")).to_be_visible()
    person.get_by_role("button", name=f"Accept task {task_id}").click()
    expect(person.get_by_text(f"Task {task_id} is yours to do")).to_be_visible()
    code = photo_code(Dao(desk.running).task(task_id)["nonce"])
    expect(person.get_by_text(f"Show the code {code} in a photo")).to_be_visible()
    person.get_by_role("button", name=f"Hand in task {task_id}").click()
    person.get_by_label("What did you do?").fill("Washed all four wheels")
    person.locator("input[type=file]").set_input_files(PHOTO)
    expect(person.get_by_text("1 photo added")).to_be_visible()
    person.get_by_role("button", name="Review").click()
    person.get_by_role("button", name="Seal and hand in").click()
    handed_in = person.get_by_role("region", name="Handed in")
    expect(handed_in.get_by_text("waiting for the ruling")).to_be_visible()

    auditor = desk.page("ada", "/work")
    expect(auditor.get_by_text(re.compile("eva for 5 IEC"))).to_be_visible()
    auditor.get_by_role("button", name=f"Judge task {task_id}").click()
    expect(auditor.get_by_text("“Washed all four wheels”")).to_be_visible()
    expect(auditor.get_by_role("img", name="Photo 1 of the work")).to_be_visible()
    known = auditor.get_by_role("list", name="Known facts about the proof")
    expect(known.get_by_text(f"One photo should show the code {code}.")).to_be_visible()
    expect(known.get_by_text("Photo 1 has 320 x 240 pixels; it has no metadata.")).to_be_visible()
    auditor.get_by_label("Why?").fill("They shine")
    auditor.get_by_role("button", name="Rule", exact=True).click()
    auditor.get_by_role("dialog", name="Rule on this work?").get_by_role("button", name="Rule").click()

    expect(handed_in.get_by_text("paid 5 IEC")).to_be_visible()
    expect(handed_in.get_by_text("accepted by an auditor (a person): “They shine”")).to_be_visible()
    open_page(auditor, f"/tasks/{task_id}")
    word = "Accepted by the auditor organization (a person): “They shine”"
    attempts = auditor.get_by_role("table", name="Attempts at this task")
    expect(attempts.get_by_text(word)).to_be_visible()
    report = auditor.get_by_role("region", name="Auditor's verdict")
    expect(report.get_by_text(word)).to_be_visible()
    expect(report.get_by_text("A person judged this proof")).to_be_visible()
    expect(report.locator(".badge")).to_have_count(0)
    expect(person.locator(".tile .value").first).to_have_text(f"{paid_iec:g} IEC")
    person.close()
    auditor.close()


@pytest.mark.long
def test_every_control_has_a_name_and_every_text_can_be_read_in_light_and_dark(desk: Desk) -> None:
    Dao(desk.running).post("1", allow_wait=True)  # so that there is a task, whatever ran before
    page, stranger = desk.page("ada"), desk.page(None)
    for path in PAGES:
        open_page(page, path)
        clock = page.get_by_role("timer", name="Site time")
        expect(clock).to_have_text(re.compile(r"^\d\d(:\d\d){2} UTC sim"))
        everything_is_named(page)
        for colours in seen(page):
            expect(page.locator("body")).to_have_class(re.compile(f"body--{colours}"))
            nothing_is_faint(page)
            axe_finds_nothing(page, again=colours == "dark")
        if path == "/":
            page.add_init_script(WITHOUT_3D)  # its views were looked at
    for path in ("/docs", "/nothing"):
        page.goto(path)
        for colours in seen(page):
            axe_finds_nothing(page, again=colours == "dark")
    for colours in seen(stranger):
        axe_finds_nothing(stranger, again=colours == "dark")
    page.close()
    stranger.close()


def seen(page: Page) -> Iterator[str]:
    """Light on a desk, then dark on a phone."""
    looks: tuple[tuple[Literal["light", "dark"], int], ...] = (("light", 1280), ("dark", 390))
    for colours, width in looks:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=colours, reduced_motion="reduce")
        yield colours


@pytest.mark.long
def test_an_operator_pauses_a_robot_stops_everything_and_sends_it_charging(desk: Desk) -> None:
    page = desk.page("ada", "/operator")
    robot = page.get_by_role("region", name="panther1")
    state = robot.locator(".badge").first
    for button, becomes in (
        ("Pause panther1", "paused"),
        ("Resume panther1", "working"),
        ("Stop everything", "stopped"),
        ("Resume panther1", "working"),
    ):
        page.get_by_role("button", name=button).click()
        expect(state).to_have_text(becomes)
    page.get_by_role("button", name="Charge panther1").click()
    open_page(page, "/tasks")
    bought = page.get_by_role("row").filter(has_text="battery charging")
    expect(bought.first).to_be_visible(timeout=WAIT_MS)
    page.close()
