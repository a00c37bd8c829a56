"""The site: one typed description of an organization's place, read from a TOML file and the environment.

`RODEO__CHAIN__URL=http://...` overrides `[chain] url`; two underscores step into a table.
"""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from rodeo.errors import ConfigError
from rodeo.site.faults import faults
from rodeo.site.file import SiteFile
from rodeo.text.site_problems import dotted, explained

_PREFIX = "RODEO__"
"""Prefix of environment variables."""


class Site(SiteFile, BaseSettings):
    """The whole configuration of a process, with what the environment overrides. Read-only once loaded."""

    model_config = SettingsConfigDict(
        env_prefix=_PREFIX, env_nested_delimiter="__", extra="forbid", allow_inf_nan=False
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return env_settings, init_settings

    @classmethod
    def load(cls, path: Path | str) -> Site:
        """The site in the TOML file at `path`. Raises ConfigError that names the file and each field, or an
        environment variable that means no field.

        `extends = "other.toml"` (relative to the file) starts from another site: tables are merged, and
        everything else, lists too, is replaced.
        """
        check_environment()
        try:
            site = cls(**read_tables(Path(path)))
        except ValidationError as error:
            fields = {dotted(place): text for place, text in explained(error, cls).items()}
            raise ConfigError("the site is not valid", path=str(path), fields=fields) from error
        if wrong := faults(site):
            fields = {dotted(place): text for place, text in wrong.items()}
            raise ConfigError("the site is not valid", path=str(path), fields=fields)
        return site


def check_environment() -> None:
    """Raises ConfigError where an environment variable means no field of the site."""
    for variable in overrides():
        _check_variable(variable)


def overrides() -> dict[str, str]:
    """The environment variables that override a site file."""
    return {name: value for name, value in os.environ.items() if name.upper().startswith(_PREFIX)}


def _check_variable(variable: str) -> None:
    """Raises ConfigError where an environment variable means no field: pydantic would pass over it."""
    model: type[BaseModel] = Site
    known: list[str] = []
    for name in variable[len(_PREFIX) :].lower().split("__"):
        if name not in model.model_fields:
            close = difflib.get_close_matches(name, model.model_fields, n=1)
            meant = _PREFIX + "__".join([*known, *close]).upper()
            raise ConfigError(
                f"the environment variable {variable} names no field of the site"
                + (f"; is {meant} meant?" if close else ""),
                known=sorted(model.model_fields),
            )
        known.append(name)
        inner = model.model_fields[name].annotation
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return  # what is in lists and dictionaries is for pydantic to say
        model = inner


def _resolve_paths(path: Path, tables: dict[str, Any]) -> None:
    """Relative paths are resolved against the site file that sets them."""
    match tables:
        case {"chain": {"secret_file": str(secret_file)} as chain}:
            chain["secret_file"] = _beside(path, "secret_file", secret_file, home=True)
    match tables:
        case {"mocap": {"source": "recorded", "address": str(recording)} as mocap}:
            mocap["address"] = _beside(path, "address", recording)
    if isinstance(data_dir := tables.get("data_dir"), str):
        # Not at the working directory: `rodeo down` finds the site from wherever it is called.
        tables["data_dir"] = _beside(path, "data_dir", data_dir, home=True)
    for robot in _listed(tables, "robots"):
        if isinstance(kinematics := robot.get("kinematics"), str):
            robot["kinematics"] = _beside(path, "kinematics", kinematics)
    for room in _listed(tables, "rooms"):
        if isinstance(shown := room.get("map"), str):
            room["map"] = _beside(path, "map", shown)
    for one in _listed(tables, "docks"):
        match one:
            case {"meter": {"model": str(model)} as meter} if model.endswith(".toml"):
                meter["model"] = _beside(path, "model", model)
    for one in _listed(tables, "bins"):
        match one:
            case {"camera": {"source": "folder", "address": str(folder)} as camera}:
                camera["address"] = _beside(path, "address", folder)


def read_tables(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """What the TOML file at `path` and those that it extends say. Raises ConfigError."""
    path = path.resolve()
    if path in seen:
        raise ConfigError("the site file extends itself", path=str(path))
    try:
        tables = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        at = re.search(r"at line (\d+)", str(reason))  # Python 3.11 tells it in words only
        line = {"line": int(at[1])} if at else {}
        raise ConfigError(f"cannot read the site file: {reason}", path=str(path), **line) from error
    _resolve_paths(path, tables)
    base = tables.pop("extends", None)
    if base is None:
        return tables
    if not isinstance(base, str):
        raise ConfigError("extends: name one file", path=str(path), extends=base)
    return _merge(read_tables(Path(_beside(path, "extends", base)), (*seen, path)), tables)


def _listed(tables: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """The tables in the list of this name; what is none is for pydantic to say."""
    listed = tables.get(name)
    return [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []


def _beside(site_file: Path, setting: str, named: str, home: bool = False) -> str:
    """A path of a site file, seen from that file. Raises ConfigError."""
    if not named.strip():
        raise ConfigError(f"{setting}: an empty text names no file or folder", path=str(site_file))
    try:
        return str((site_file.parent / (Path(named).expanduser() if home else named)).resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"{setting}: this names no file or folder: {error}", path=str(site_file), named=named
        ) from error


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        merged[key] = _merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
