"""What people need who cannot see well or use no mouse, as the browser itself knows it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from tests.support.site import WAIT_S

_NAMED = {"button", "link", "textbox", "searchbox", "spinbutton", "combobox", "checkbox", "slider"}
_NAMED |= {"menuitem", "image", "progressbar", "table", "region"}
MIN_CONTRAST = 4.5
"""WCAG 2.2, 1.4.3 (AA) for text of this size."""
_MAX_TABS = 150

_FAINT = (Path(__file__).parent / "faint.js").read_text()
_FOCUSED = """() => {
  const element = document.activeElement;
  if (!element || element === document.body) return null;
  const ring = (e) => getComputedStyle(e).outlineStyle !== "none";
  const field = element.closest(".q-field");
  return ring(element) || Boolean(field?.matches(".q-field--highlighted, .q-field--focused"));
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


def unnamed(page: Page) -> list[str]:
    """Controls, pictures and regions without a name, each by its role."""
    return [
        role
        for node in _nodes(page)
        if (role := _said(node, "role")) in _NAMED and not _said(node, "name").strip()
    ]


def nothing_is_faint(page: Page) -> None:
    """No text stays too like what is behind it; colours may still be changing when this is called."""
    deadline_s = time.monotonic() + WAIT_S
    while found := page.evaluate(_FAINT, MIN_CONTRAST):
        assert time.monotonic() < deadline_s, f"{page.url}: {found}"
        page.wait_for_timeout(100)


def tab_to(page: Page, name: str) -> None:
    """Press Tab until the control of this name has the focus, and can be seen to have it all the way."""
    passed = []
    for _ in range(_MAX_TABS):
        page.keyboard.press("Tab")
        visible = page.evaluate(_FOCUSED)
        focused = next((node for node in _nodes(page) if _has_focus(node)), None)
        here = "" if focused is None else _said(focused, "name")
        assert visible is not False, f"nothing shows that {here!r} has the focus"
        if here == name:
            return
        passed.append(here)
    raise AssertionError(f"no Tab leads to {name!r}, only to {passed}")


def _has_focus(node: dict[str, Any]) -> bool:
    if _said(node, "role") in ("RootWebArea", "WebArea"):
        return False
    return any(
        one["name"] == "focused" and one["value"].get("value") is True for one in node.get("properties", [])
    )
