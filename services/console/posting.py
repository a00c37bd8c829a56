"""What is wrong with a task before it costs anything: for the form, and for programs."""

from __future__ import annotations

import math

from rodeo.config import Site
from rodeo.dao import CHARGING, CLEANING
from rodeo.lab.layout import BinLayout
from rodeo.messages import RegisterTask

MIN_WINDOW_S = 60


def problems(site: Site, request: RegisterTask) -> dict[str, str]:
    """Field -> what to do about it; empty when the task can be posted here.

    What only the chain knows (prices, funds, kinds) the bridge checks before it sends anything.
    """
    wrong: dict[str, str] = {}
    if request.reward_iec <= 0 and request.kind in (CLEANING, CHARGING):
        wrong["reward_iec"] = "offer more than 0 IEC"
    if request.execution_window_s is not None and request.execution_window_s < MIN_WINDOW_S:
        wrong["execution_window_s"] = f"give the executor at least {MIN_WINDOW_S} s"
    if request.kind == CLEANING:
        wrong |= _cleaning(site, request)
    elif request.kind == CHARGING:
        wrong |= _charging(site, request)
    return wrong


def _cleaning(site: Site, request: RegisterTask) -> dict[str, str]:
    wrong = {}
    known = [item.id for item in site.items]
    if request.params.get("item_id") not in known:
        wrong["params.item_id"] = _choose("item", known)
    x_m, y_m = request.params.get("x_m"), request.params.get("y_m")
    if not (_is_number(x_m) and _is_number(y_m)):
        wrong["params.x_m"] = "choose the place on the map"
    elif (reason := place_problem(site, float(x_m), float(y_m))) is not None:  # type: ignore[arg-type]
        wrong["params.x_m"] = reason
    return wrong


def place_problem(site: Site, x_m: float, y_m: float) -> str | None:
    """Why no item can lie on the floor there; None when it can."""
    width_m, height_m = site.lab.size_m
    if not (0 <= x_m <= width_m and 0 <= y_m <= height_m):
        return f"the place is outside the lab, which is {width_m:g} m by {height_m:g} m"
    layout = BinLayout(site.bin)
    boxes = [(one.name, one.pose, one.size_m[0], one.size_m[1]) for one in site.lab.furniture]
    for name, pose, length_m, depth_m in [
        *boxes,
        (site.bin.name, site.bin.pose, layout.depth_m, layout.width_m),
    ]:
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        dx, dy = x_m - pose.x_m, y_m - pose.y_m
        if abs(c * dx + s * dy) <= length_m / 2 and abs(c * dy - s * dx) <= depth_m / 2:
            return f"{name} stands there"
    return None


def _charging(site: Site, request: RegisterTask) -> dict[str, str]:
    wrong = {}
    robots = [robot.name for robot in site.robots]
    if request.params.get("robot") not in robots:
        wrong["params.robot"] = _choose("robot", robots)
    if request.params.get("dock") != site.dock.name:
        wrong["params.dock"] = f"the dock of this site is {site.dock.name}"
    soc_from, soc_target = request.params.get("soc_from"), request.params.get("soc_target")
    if not (_is_number(soc_from) and _is_number(soc_target)) or not 0 <= soc_from < soc_target <= 1:  # type: ignore[operator]
        wrong["params.soc_target"] = "charge to more than what is left, and to at most 100 %"
    energy_wh = request.params.get("energy_wh")
    if not _is_number(energy_wh) or energy_wh <= 0:  # type: ignore[operator]
        wrong["params.energy_wh"] = "say how much energy is ordered"
    return wrong


def _choose(what: str, known: list[str]) -> str:
    return f"choose one of this site: {', '.join(known)}" if known else f"this site has no {what}"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
