"""A form's fields for the parameters of a kind of work, from their JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui
from nicegui.events import UploadEventArguments

from rodeo.bus.session import decode_json
from rodeo.display.formatting import parameter
from rodeo.kinds import Kind
from rodeo.person import photos
from rodeo.person.statement import MAX_PHOTO_BYTES
from rodeo.site.config import Site
from rodeo.text.strict_json import Json
from services.console.pages import frame, widgets


class Parameters:
    """The fields of one kind. Those that follow from others are not shown; without a schema there is one
    field for a JSON object."""

    def __init__(self, site: Site, kind: Kind | None, changed: Callable[[], None]) -> None:
        self._site = site
        self._inside: Mapping[str, str] = {}
        self.proposed: tuple[float, float] | None = None
        """The place that was filled in for an item."""
        self._properties: Json = {
            name: schema
            for name, schema in (kind.schema.get("properties", {}) if kind else {}).items()
            if schema.get("format") != "follows"
        }
        anything = kind is not None and kind.subject not in kind.problems(site, {})
        self._items = {item.id: f"{item.id} ({item.item_class.value})" for item in site.items} | (
            {"": "whatever lies at the place"} if anything else {}
        )
        self.fields: dict[str, Any] = {
            name: self._field(name, schema, changed) for name, schema in self._properties.items()
        }
        self._whole = None
        if not self._properties:
            self._whole = ui.textarea("Parameters (JSON object)", value="{}", on_change=changed)
            self._whole.classes("whole")
        for one in self._elements():
            one.props("outlined dense")

    def _elements(self) -> list[Any]:
        return [*self.fields.values(), *([self._whole] if self._whole is not None else [])]

    def offer_items(self, inside: Mapping[str, str]) -> None:
        """Offer the items that lie in no bin, and say which do, as `scene.in_bins` has it."""
        if (field := self.field("item")) is None or inside == self._inside:
            return
        self._inside = inside
        offered = {item: text for item, text in self._items.items() if item not in inside}
        field.set_options(offered, value=field.value if field.value in offered else next(iter(offered), None))
        said = "; ".join(f"{item} lies in {where}" for item, where in inside.items())
        field.props(f"hint={json.dumps(said)}")

    def show(self, visible: bool) -> None:
        for one in self._elements():
            one.visible = visible

    def field(self, form: str) -> Any:
        """The field of this format, if there is one."""
        return next((self.fields[name] for name, one in self._properties.items() if _form(one) == form), None)

    async def photos_taken(self, button: ui.button) -> bool:
        """Wait for photos that are on their way, as `FileDrop.all_taken` does."""
        fields = [field for field in self.fields.values() if isinstance(field, PhotoField)]
        while waiting := next((field for field in fields if field.is_waiting), None):
            if not await waiting.all_taken(button):
                return False
        return True

    def values(self) -> Json:
        """Values of the fields; empty ones are left out. Raises MalformedJson."""
        if self._whole is not None:
            return decode_json((self._whole.value or "{}").encode())
        return {
            name: _read(self._properties[name], field.value)
            for name, field in self.fields.items()
            if field.value not in (None, "")
        }

    def fill(self, params: Mapping[str, Any]) -> None:
        """Fill in another task's parameters, where this form has fields for them."""
        if self._whole is not None:
            self._whole.value = json.dumps(params)
        for name, field in self.fields.items():
            value = _shown(self._properties[name], params.get(name))
            if value is not None and (not hasattr(field, "options") or value in field.options):
                field.value = value

    def _field(self, name: str, schema: Json, changed: Callable[[], None]) -> Any:
        if _form(schema) == "item":
            first = next(iter(self._items), None)
            return ui.select(self._items, value=first, label=label(name, schema), on_change=changed)
        if _form(schema) == "photo":
            return PhotoField(self._site, label(name, schema), changed)
        return _field(self._site, name, schema, changed)

    def told(self) -> list[tuple[str, str]]:
        """Each field's label and value, for the person who confirms them; without those that are empty."""
        return [
            (label(name, self._properties[name]), str(field.value) or field.options[""])
            for name, field in self.fields.items()
            if field.value is not None and (field.value != "" or hasattr(field, "options"))
        ]


class PhotoField(widgets.FileDrop):
    """Puts a photo into the site's store; `value` is its name there. One that is filled in is shown, as the
    browser shows one that is chosen."""

    def __init__(self, site: Site, label: str, changed: Callable[[], None]) -> None:
        self._name: str | None = None
        self._site, self._changed = site, changed
        super().__init__(
            f"or drop it here. {label} (JPEG or PNG)",
            "image/jpeg,image/png",
            self._keep,
            max_file_size=MAX_PHOTO_BYTES,
            max_files=1,
            on_rejected=lambda: ui.notify("One JPEG or PNG picture of at most 8 MB", type="warning"),
        )
        self.classes("whole")
        # Quasar's list of files has a button that takes one out again.
        self.on("removed", lambda: self._set(None), args=[])
        with ui.element("div").classes("whole").bind_visibility_from(self):
            self._shown = widgets.Section(self._draw)

    @property
    def value(self) -> str | None:
        return self._name

    @value.setter
    def value(self, name: str | None) -> None:
        self._name = name
        self._shown.show(name)

    def _draw(self, name: str | None) -> None:
        if name is not None:
            widgets.picture(f"/files/photo/{name}", "The photo of what lies there")
            ui.button("Without this photo", on_click=self._take_out).props("flat dense")

    def _take_out(self) -> None:
        self.reset()
        self._set(None)

    def _set(self, name: str | None) -> None:
        self.value, self._name = None, name
        self._changed()

    async def _keep(self, event: UploadEventArguments) -> None:
        self._set(await frame.asked(photos.keep, self._site, await event.file.read()))


_THINGS: dict[str, Callable[[Site], list[str]]] = {
    "robot": lambda site: [one.name for one in site.robots],
    "bin": lambda site: [one.name for one in site.bins],
    "dock": lambda site: [one.name for one in site.docks],
    "place": lambda site: [one.name for one in site.places],
}
"""Format of a parameter -> what of the site it can name."""
_NUMBERS: dict[str, Json] = {
    "percent": {"min": 0, "max": 100},
    "map-x": {"step": 0.05, "format": "%.2f"},
    "map-y": {"step": 0.05, "format": "%.2f"},
}


def _field(site: Site, name: str, schema: Json, changed: Callable[[], None]) -> Any:
    how: Json = {"label": label(name, schema), "on_change": changed}
    form, kind = _form(schema), schema.get("type")
    proposed = _shown(schema, next(iter(schema.get("examples", [])), None))
    if form in _THINGS:
        things, needed = _THINGS[form](site), form == "robot"
        first = next(iter(things), None) if needed else None
        return ui.select(things, value=first, clearable=not needed, **how)
    if "enum" in schema:
        return ui.select(schema["enum"], value=proposed, **how)
    if kind in ("number", "integer"):
        limits = {"min": schema.get("minimum"), "max": schema.get("maximum")}
        whole = {"precision": 0} if kind == "integer" else {}
        proposed = None if form.startswith("map-") else proposed
        return ui.number(value=proposed, **_NUMBERS.get(form, limits | whole), **how)
    if kind == "boolean":
        return ui.checkbox(how["label"], value=bool(proposed), on_change=changed)
    return ui.input(value=proposed or "", **how)


def label(name: str, schema: Json) -> str:
    return str(schema.get("title") or parameter(name))


def _form(schema: Json) -> str:
    return str(schema.get("format", ""))


def _shown(schema: Json, value: Any) -> Any:
    """A parameter's value as its field shows it."""
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, int | float):
        return round(100 * value) if _form(schema) == "percent" else value
    return json.dumps(value)


def _read(schema: Json, value: Any) -> Any:
    """A field's content as the parameter's value. Raises MalformedJson."""
    if _form(schema) == "percent":
        return value / 100
    if schema.get("type") == "integer":
        return int(value)
    if schema.get("type") in ("object", "array"):
        return decode_json(str(value).encode())
    return value
