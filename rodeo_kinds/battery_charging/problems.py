"""What is wrong with an order of energy at a site, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rodeo.charging import order_wh
from rodeo.config import Site
from rodeo.kinds import choose, is_number


def problems(site: Site, params: Mapping[str, Any]) -> dict[str, str]:
    """Field -> what to do about it."""
    wrong = {}
    robots = [robot.name for robot in site.robots]
    if params.get("robot") not in robots:
        wrong["robot"] = choose("robot", robots)
    if params.get("dock") != site.dock.name:
        wrong["dock"] = f"the dock of this site is {site.dock.name}"
    soc_from, soc_target = params.get("soc_from"), params.get("soc_target")
    if not (is_number(soc_from) and is_number(soc_target)) or not 0 <= soc_from < soc_target <= 1:  # type: ignore[operator]
        wrong["soc_target"] = "choose a target above the present charge and at most 100 %"
    energy_wh = params.get("energy_wh")
    if not is_number(energy_wh) or energy_wh <= 0:  # type: ignore[operator]
        wrong["energy_wh"] = "enter the energy to order, above 0 Wh"
    return wrong


def complete(site: Site, params: Mapping[str, Any]) -> dict[str, Any]:
    """With the site's dock where none is named, and with the energy, Wh, where it is left out."""
    whole = {"dock": site.dock.name, **params}
    robot = next((one for one in site.robots if one.name == whole.get("robot")), None)
    soc_from, soc_target = whole.get("soc_from"), whole.get("soc_target")
    if robot and "energy_wh" not in whole and is_number(soc_from) and is_number(soc_target):
        whole["energy_wh"] = order_wh(robot.battery, site.dock, soc_from, soc_target)  # type: ignore[arg-type]
    return whole
