"""What is wrong with an order of energy at a site, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rodeo.charging.orders import order_wh
from rodeo.kinds import choose, is_number
from rodeo.site.config import Site


def problems(site: Site, params: Mapping[str, Any]) -> dict[str, str]:
    """Field -> what to do about it."""
    wrong = {}
    robots = [robot.name for robot in site.robots]
    if params.get("robot") not in robots:
        wrong["robot"] = choose("robot", robots)
    docks = [dock.name for dock in site.docks]
    if params.get("dock") not in (None, *docks):
        wrong["dock"] = choose("dock", docks)
    soc_from, soc_target = params.get("soc_from"), params.get("soc_target")
    if not (is_number(soc_from) and is_number(soc_target)) or not 0 <= soc_from < soc_target <= 1:  # type: ignore[operator]
        wrong["soc_target"] = "choose a target above the present charge and at most 100 %"
    energy_wh = params.get("energy_wh")
    if not is_number(energy_wh) or energy_wh <= 0:  # type: ignore[operator]
        wrong["energy_wh"] = "enter the energy to order, above 0 Wh"
    return wrong


def complete(site: Site, params: Mapping[str, Any]) -> dict[str, Any]:
    """`params` with the site's only dock if none is named, and with the energy (Wh) if it is left out."""
    whole = dict(params)
    if len(site.docks) == 1:
        whole.setdefault("dock", site.docks[0].name)
    dock = next((one for one in site.docks if whole.get("dock") in (None, one.name)), None)
    robot = next((one for one in site.robots if one.name == whole.get("robot")), None)
    soc_from, soc_target = whole.get("soc_from"), whole.get("soc_target")
    if robot and dock and "energy_wh" not in whole and is_number(soc_from) and is_number(soc_target):
        whole["energy_wh"] = order_wh(robot.battery, dock, soc_from, soc_target)  # type: ignore[arg-type]
    return whole
