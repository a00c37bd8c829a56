"""What people need who cannot see well or use no mouse, as the browser itself knows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Error, Locator, Page

from rodeo_testing.waiting import wait_until

_NAMED = {"button", "link", "textbox", "searchbox", "spinbutton", "combobox", "checkbox", "slider"}
_NAMED |= {"menuitem", "image", "progressbar", "table", "region"}
MIN_CONTRAST = 4.5
"""WCAG 2.2, 1.4.3 (AA) for text of this size."""

_AXE = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"
_VIOLATIONS = """async (how) => (await axe.run({resultTypes: ["violations"], ...how})).violations
  .filter((rule) => ["serious", "critical"].includes(rule.impact))
  .flatMap((rule) => rule.nodes.map((node) => `${rule.id} (${rule.impact}): ${node.html.slice(0, 200)}`))"""
_OF_LOOKS = ("color-contrast", "link-in-text-block", "scrollable-region-focusable")
"""Rules that depend on colours and widths. What others ask of a page, its width does not change."""
_FAINT = (Path(__file__).parent / "faint.js").read_text()
_MAX_TABS = 100
_UNSEEN_FOCUS = """() => {
  const element = document.activeElement;
  if (!element || element === document.body) return "";  // the browser's own controls
  const field = element.closest(".q-field");
  const lit = field ? field.matches(".q-field--highlighted, .q-field--focused") : false;
  const ring = lit || getComputedStyle(element).outlineStyle !== "none";
  const box = (field ?? element).getBoundingClientRect();
  const inSight = box.bottom > 0 && box.top < innerHeight && box.right > 0 && box.left < innerWidth;
  return ring && inSight ? "" : element.outerHTML.slice(0, 200);
}"""


def _nodes(page: Page) -> list[dict[str, Any]]:
    """The accessibility tree, as a screen reader gets it."""
    session = page.context.new_cdp_session(page)
    try:
        return [node for node in session.send("Accessibility.getFullAXTree")["nodes"] if not node["ignored"]]
    finally:
        session.detach()


def _said(node: dict[str, Any], what: str) -> str:
    return str(node.get(what, {}).get("value", ""))


def everything_is_named(page: Page) -> None:
    """No control, picture or region stays without a name; the page may still be drawn when this is called."""
    _until_none(
        page, lambda: [role for node in _nodes(page) if _is_unnamed(role := _said(node, "role"), node)]
    )


def axe_finds_nothing(page: Page, again: bool = False) -> None:
    """axe-core finds nothing serious or critical; the page may still be drawn when this is called. `again`:
    with other colours or another width than before."""
    if not _AXE.exists():
        pytest.skip("axe-core is missing: make setup")
    _until_none(page, lambda: axe_faults(page, _OF_LOOKS if again else ()))


def axe_faults(page: Page, rules: Sequence[str] = ()) -> list[str]:
    """What axe-core finds serious or critical now, by these rules or by all."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(f"() => {{ {_AXE.read_text()}\n }}")
    only = {"runOnly": {"type": "rule", "values": list(rules)}} if rules else {}
    return list(page.evaluate(_VIOLATIONS, only))


def nothing_is_faint(page: Page) -> None:
    """No text stays too like what is behind it; colours may still be changing when this is called."""
    _until_none(page, lambda: page.evaluate(_FAINT, MIN_CONTRAST))


def _is_unnamed(role: str, node: dict[str, Any]) -> bool:
    return role in _NAMED and not _said(node, "name").strip()


_LOADED_AGAIN = "Execution context was destroyed", "axe is not defined"


def _until_none(page: Page, find: Callable[[], list[str]]) -> None:
    def found() -> list[str]:
        try:
            return find()
        except Error as error:
            # A page whose connection was lost for long loads itself again.
            if not any(said in error.message for said in _LOADED_AGAIN):
                raise
            return ["the page was loaded again"]

    wait_until(lambda: not found(), lambda: f"{page.url}: {found()}")


def tab_to(page: Page, control: Locator) -> None:
    """Press Tab until the control has the focus, which can be seen wherever it is on the way."""
    control.wait_for(state="attached")
    for _ in range(_MAX_TABS):
        page.keyboard.press("Tab")
        hidden = page.evaluate(_UNSEEN_FOCUS)
        assert not hidden, f"{page.url}: nobody sees that this has the focus: {hidden}"
        if control.evaluate("(element) => element === document.activeElement"):
            return
    raise AssertionError(f"no Tab leads to {control}")
