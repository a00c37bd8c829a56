"""The console when what it needs goes away under an open page, and when programs send anything.

Router, chain, bridge and console are real; requests are made from the interface's own OpenAPI document, and
what fits it reaches the contracts.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, settings
from playwright.sync_api import Page, expect
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance

from rodeo.errors import BusError
from services.console.accounts import Accounts, accounts_path
from services.console.rest import make_api
from services.console.roles import Role
from tests.support.browser import chromium, log_in
from tests.support.dao import Dao
from tests.support.site import WAIT_S, RunningSite, write_site

PASSPHRASE = "correct horse battery"
expect.set_options(timeout=1e3 * WAIT_S)


class Desk:
    """The console, the organization behind it, and who may use both."""

    def __init__(self, running: RunningSite) -> None:
        self.running = running
        self.dao = Dao(running)
        self.dao.start()
        running.start("console")
        self.origin = str(running.status("console").details["http"])
        self.dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        self._accounts = Accounts(accounts_path(running.site), running.site.console)
        self._accounts.add_user("ada", PASSPHRASE, list(Role), "organization")

    def headers(self) -> dict[str, str]:
        """With a token of their own: one of the requests is to revoke some."""
        return {"Authorization": f"Bearer {self._accounts.issue_token('ada', 'fuzz')}"}

    def cancel(self, task_id: int) -> None:
        """As soon as the bridge can be asked: it is ready before everybody knows where it is again."""
        deadline_s = time.monotonic() + WAIT_S
        while True:
            with suppress(BusError):
                # The same request twice is carried out once.
                self.dao.command(
                    "organization", "cancel_task", task_id=task_id, request_id=f"cancel-{task_id}"
                )
                return
            assert time.monotonic() < deadline_s, self.running.log("bridge")


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Desk]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("faults"), chain_backend))
    try:
        desk = Desk(running)
        yield desk
        desk.dao.stop()
    finally:
        running.stop()


@pytest.fixture(scope="module")
def page(desk: Desk) -> Iterator[Page]:
    """Logged in."""
    with chromium() as browser:
        page = browser.new_page(base_url=desk.origin)
        page.set_default_timeout(1e3 * WAIT_S)
        page.goto("/")
        log_in(page, "ada", PASSPHRASE)
        expect(page.get_by_role("heading", name="Overview")).to_be_visible()
        yield page


@pytest.mark.parametrize("process", ["bridge", "router", "console"])
def test_an_open_page_says_that_it_is_not_current_and_recovers_by_itself(
    desk: Desk, page: Page, process: str
) -> None:
    task_id = desk.dao.post("1", allow_wait=True)
    page.goto(f"{desk.origin}/tasks/{task_id}")
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


# Made here, and not asked of the process, so that each of its operations is a test of its own.
DOCUMENT = make_api(SimpleNamespace(reads=None)).openapi()
SCHEMA = schemathesis.openapi.from_dict(DOCUMENT)
# One case for each limit of each field is a thousand requests; chance finds its way with fewer.
SCHEMA.config.phases.coverage.enabled = False


def test_the_process_describes_itself_with_this_document(desk: Desk) -> None:
    assert httpx.get(f"{desk.origin}/api/openapi.json", timeout=WAIT_S).json()["paths"] == DOCUMENT["paths"]


@SCHEMA.parametrize()
@settings(max_examples=5, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_whatever_the_document_allows_or_forbids_gets_a_documented_answer(
    case: schemathesis.Case, desk: Desk
) -> None:
    # What fits may be refused by the organization, a 0 is as good as false, and 503 and 504 are promised
    # where the bridge is away or too slow.
    answer = case.call_and_validate(
        base_url=f"{desk.origin}/api",
        headers=desk.headers(),
        timeout=2 * WAIT_S,
        excluded_checks=[positive_data_acceptance, negative_data_rejection, not_a_server_error],
    )
    assert answer.status_code not in (500, 501, 502), answer.text
