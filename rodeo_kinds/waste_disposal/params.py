"""What the creator of a cleaning and the robot that does it agree on, and what it comes to at a site."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from rodeo.bus.messages import Task
from rodeo.charging.orders import Name, Number, shown
from rodeo.errors import InvalidRequest
from rodeo.kinds import PHOTO, SAME_PLACE_M, choose, is_number
from rodeo.lab.layout import BinLayout, furniture_floor
from rodeo.site.config import Site
from rodeo.site.sections import interface_of

FARTHEST_M = 10_000.0
"""From the origin of a site's map: no robot drives so far."""
Photo = Annotated[str, Field(pattern=PHOTO)]
Coordinate = Annotated[Number, Field(ge=-FARTHEST_M, le=FARTHEST_M)]

_UNDER_WAY = ("open", "assigned", "submitted", "ruled")


class CleaningParams(BaseModel):
    """Parameters of a task: the item, its place (m in frame `map`), and the bin."""

    model_config = ConfigDict(extra="allow")

    item_id: Annotated[str, Field(max_length=64), shown("Item", "item")] = ""
    """Empty where it is about what lies at the place."""
    x_m: Annotated[Coordinate, shown("East, x (m)", "map-x")]
    y_m: Annotated[Coordinate, shown("North, y (m)", "map-y")]
    bin: Annotated[Name | None, shown("Bin", "bin")] = None
    """If it is left out, the robot chooses."""
    photo: Annotated[Photo | None, shown("Photo of what lies there", "photo")] = None
    """For who judges: no robot and no oracle looks at it."""


def doubt(params: Mapping[str, Any], tasks: Sequence[Task]) -> str:
    """Why a new task is probably about nothing, or about what another one is about; empty if nothing suggests
    that."""
    item_id = params.get("item_id")
    if not item_id:
        return _doubt_of_place(params, tasks)
    for task in tasks:
        if task.params.get("item_id") != item_id:
            continue
        if task.state in _UNDER_WAY:
            return f"task {task.id}, which is {task.state}, already moves {item_id}"
        if task.state == "settled" and task.verdict == "accepted":
            return (
                f"task {task.id} was paid for carrying {item_id} to the bin; unless somebody took it out "
                "again, this task will fail"
            )
    return ""


def _doubt_of_place(params: Mapping[str, Any], tasks: Sequence[Task]) -> str:
    if (place := _place(params)) is None:
        return ""
    for task in tasks:
        other = _place(task.params) if task.state in _UNDER_WAY else None
        if other is not None and (apart_m := math.dist(place, other)) < SAME_PLACE_M:
            return f"task {task.id}, which is {task.state}, is about what lies {apart_m:.2f} m from there"
    return ""


def _place(params: Mapping[str, Any]) -> tuple[float, float] | None:
    x_m, y_m = params.get("x_m"), params.get("y_m")
    return (float(x_m), float(y_m)) if is_number(x_m) and is_number(y_m) else None  # type: ignore[arg-type]


def complete(site: Site, params: Mapping[str, Any]) -> dict[str, Any]:
    """With the place that the site file gives the item, where none is said. Raises InvalidRequest."""
    if wrong := unprovable(site, params):
        raise InvalidRequest("nobody could prove here what became of something without markers", fields=wrong)
    pose = next((item.pose for item in site.items if item.id == params.get("item_id")), None)
    return dict(params) if pose is None else {"x_m": pose.x_m, "y_m": pose.y_m, **params}


def problems(site: Site, params: Mapping[str, Any]) -> dict[str, str]:
    """Field -> what to do about it."""
    wrong = unprovable(site, params)
    known = [item.id for item in site.items]
    if params.get("item_id", "") not in ["", *known]:
        wrong["item_id"] = choose("item", known)
    x_m, y_m = params.get("x_m"), params.get("y_m")
    if not (is_number(x_m) and is_number(y_m)):
        wrong["x_m"] = f"choose {'' if params.get('item_id') else 'an item, or '}the place on the map"
    elif (reason := _occupied(site, float(x_m), float(y_m))) is not None:  # type: ignore[arg-type]
        wrong["x_m"] = reason
    bins = [one.name for one in site.bins]
    if params.get("bin") not in (None, *bins):
        wrong["bin"] = choose("bin", bins)
    return wrong


def unprovable(site: Site, params: Mapping[str, Any]) -> dict[str, str]:
    """Field -> what to do about it, where nobody could prove what became of something without markers."""
    if params.get("item_id") or _takes_anything(site):
        return {}
    return {"item_id": choose("item", [item.id for item in site.items])}


def _takes_anything(site: Site) -> bool:
    """Whether a task without an item can be proven: motion capture sees grippers, and a robot has one."""
    armed = any(interface_of(robot).arm for robot in site.robots)
    return site.lab.mocap and site.lab.mocap_gripper and armed


def _occupied(site: Site, x_m: float, y_m: float) -> str | None:
    """Why no item can lie on the floor there; None when it can."""
    width_m, height_m = site.lab.size_m
    if not (0 <= x_m <= width_m and 0 <= y_m <= height_m):
        return f"the place is outside the lab, which is {width_m:g} m by {height_m:g} m"
    floors = [(one.name, furniture_floor(one)) for one in site.lab.furniture]
    floors += [(one.name, BinLayout(one).floor) for one in site.bins]
    return next((f"{name} stands there" for name, floor in floors if floor.contains(x_m, y_m)), None)
