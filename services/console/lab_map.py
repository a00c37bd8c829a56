"""The lab as elements of a page: its map, its view in three dimensions, and the replay that moves both."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui
from nicegui.events import GenericEventArguments

from rodeo.bus.queries import SeenThing
from rodeo.text.strict_json import Json

MARGIN_M = 0.35
"""Around the map, as `lab_map.js` draws it: both views are as high."""


class LabMap(ui.element, component="lab_map.js"):
    """`lab` is `scene.lab(site)`. With `on_place(x_m, y_m)` a click on the floor chooses a place."""

    def __init__(self, lab: Json, label: str, on_place: Callable[[float, float], None] | None = None) -> None:
        super().__init__()
        self._props["lab"] = lab
        self._props["label"] = label
        self._props["pick"] = on_place is not None
        if on_place is not None:

            def place(event: GenericEventArguments) -> None:
                x_m, y_m = event.args
                on_place(float(x_m), float(y_m))

            self.on("place", place)

    def show(self, state: Json) -> None:
        """Move robots and items to where `Live.map` says, unless a recording is shown."""
        self.run_method("live", state)

    def show_things(self, things: list[SeenThing]) -> None:
        """Show what robots have seen on the floor."""
        self.run_method("things", [{"id": one.id, "x": one.x_m, "y": one.y_m} for one in things])

    def mark_place(self, place: tuple[float, float] | None) -> None:
        self.run_method("mark", None if place is None else list(place))


class LabScene(ui.element, component="lab_scene.js"):
    """Shows what the `LabMap` in the same `LabViews` shows; it loads `solids` itself."""

    _three = ui.scene
    """Serves three.js under the name by which the component imports it."""

    def __init__(self, lab: Json, label: str) -> None:
        super().__init__()
        self._props["label"] = label
        self._props["source"] = "/files/lab.json"
        width_m, height_m = lab["size_m"]
        self._props["ratio"] = (width_m + 2 * MARGIN_M) / (height_m + 2 * MARGIN_M)


class LabReplay(ui.element, component="lab_replay.js"):
    def show(self, track: Json | None) -> None:
        """Show a recording (`replay.track`) in the views beside it; None ends that."""
        self.run_method("replay", track)


class LabViews:
    """Both views side by side. What `map` shows live, or `replay` of a recording, moves both."""

    def __init__(self, lab: Json, what: str) -> None:
        with ui.element("div").classes("lab-views") as self.element:
            LabScene(lab, f"The lab in three dimensions: {what}")
            self.map = LabMap(lab, f"Map of the lab: {what}")
            self.replay = LabReplay()
