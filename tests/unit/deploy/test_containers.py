"""The Dockerfile and the compose file that `rodeo deploy compose` writes."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
import yaml
from typer.testing import CliRunner

from deploy.containers import DATA, USER_ID, containers
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo_cli import app
from tests.support.extras import PROJECT
from tests.support.site import LAB, write_real_site, write_site

SCHEMA = json.loads(
    (files("check_jsonschema") / "builtin_schemas" / "vendor" / "compose-spec.json").read_text()
)
"""The Compose Specification's own."""


def written(path: Path) -> dict[str, str]:
    return containers(Site.load(path), path, Path("/etc/rodeo/passphrase"))


def composed(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(written(path)["compose.yaml"])
    return document


@pytest.fixture
def real(tmp_path: Path) -> Path:
    """A site of real devices on somebody's chain, in a folder whose name compose would fill in."""
    return write_real_site(
        tmp_path / "lab: $HOME", 'store.url = "s3://bucket/store"\nmetrics.ports.charger = 9999'
    )


def test_the_schema_of_compose_accepts_the_file_and_refuses_a_misspelt_one(real: Path) -> None:
    validator = jsonschema_rs.validator_for(SCHEMA)
    for path in (LAB, real):
        validator.validate(document := composed(path))
    document["services"]["charger"]["healthchek"] = {}
    assert not validator.is_valid(document)


def test_each_process_has_a_container_that_can_change_nothing_but_its_data(real: Path) -> None:
    for path in (LAB, real):
        services = composed(path)["services"]
        assert list(services) == [*(one.name for one in processes_of(Site.load(path))), "rodeo"]
        for one in services.values():
            assert one["user"] == f"{USER_ID}:{USER_ID}" and one["read_only"] is True
            assert one["cap_drop"] == ["ALL"] and one["security_opt"] == ["no-new-privileges:true"]
            writable = [mount["target"] for mount in one["volumes"] if not mount.get("read_only")]
            assert writable == [DATA]


def test_each_image_is_a_target_of_the_dockerfile_with_one_extra(real: Path) -> None:
    for path, more in ((LAB, ""), (real, ",s3")):
        found, services = written(path)["Dockerfile"], composed(path)["services"].values()
        targets = re.split(r"^FROM base AS ", found, flags=re.MULTILINE)[1:]
        by_extra = {text.partition("\n")[0]: text for text in targets}
        assert {one["build"]["target"] for one in services} == by_extra.keys()
        assert by_extra.keys() <= PROJECT["optional-dependencies"].keys()
        for extra, text in by_extra.items():
            assert f"[{extra}{more}]" in text
            assert text.rstrip().endswith(f"USER {USER_ID}:{USER_ID}"), "nothing runs as root"


def test_health_is_asked_where_the_process_serves_it_and_nowhere_twice(real: Path) -> None:
    for path in (LAB, real):
        asked = set()
        for name, one in composed(path)["services"].items():
            if name != "rodeo":
                ((process, port),) = json.loads(one["environment"]["RODEO__METRICS__PORTS"]).items()
                assert process == name and f"127.0.0.1:{port}/readyz" in one["healthcheck"]["test"][-1]
                asked.add(port)
        assert len(asked) == len(processes_of(Site.load(path)))
    assert 9999 in asked, "the site file says it"


def test_the_ports_reach_the_site_that_a_container_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    environment = composed(LAB)["services"]["oracle"]["environment"]
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    site = Site.load(environment["RODEO_SITE"])
    assert site.metrics.ports["oracle"] == json.loads(environment["RODEO__METRICS__PORTS"])["oracle"]
    assert site.data_dir == Path(DATA)


def test_secrets_reach_only_the_processes_that_use_them(real: Path) -> None:
    document = composed(real)
    assert document["secrets"]["passphrase"] == {"file": "/etc/rodeo/passphrase"}
    for process, secrets in {
        "bridge": ["passphrase", "node-key"],
        "charger": ["passphrase"],
        "router": [],
        "rodeo": ["passphrase", "node-key"],
    }.items():
        one = document["services"][process]
        assert one.get("secrets", []) == secrets
        key = one["environment"]["RODEO__CHAIN__SECRET_FILE"]
        assert key == ("/run/secrets/node-key" if "node-key" in secrets else "/no-key")
        passphrase = one["environment"].get("RODEO_KEYSTORE_PASSPHRASE_FILE")
        assert passphrase == ("/run/secrets/passphrase" if "passphrase" in secrets else None)


def test_a_dock_may_use_its_serial_line_and_nobody_any_other_device(real: Path) -> None:
    services = composed(real)["services"]
    assert services["charger"]["devices"] == ["/dev/ttyUSB0:/dev/ttyUSB0"]
    assert [name for name, one in services.items() if "devices" in one] == ["charger"]


def test_what_the_site_file_names_is_mounted_where_it_is_and_no_variable_is_filled_in(real: Path) -> None:
    mounts = composed(real)["services"]["router"]["volumes"]
    sources = [one["source"].replace("$$", "$") for one in mounts if one["type"] == "bind"]
    assert sources == [str(real), str(LAB.resolve())], "and not the node's key"
    assert not re.search(r"(?<!\$)\$(?!\$)", written(real)["compose.yaml"])


def test_the_command_writes_them(tmp_path: Path) -> None:
    given = ["deploy", "compose", "--site", str(write_site(tmp_path)), "--out", str(tmp_path / "images")]
    assert "compose.yaml with 9 containers" in CliRunner().invoke(app, given).stdout
    names = sorted(one.name for one in (tmp_path / "images").iterdir())
    assert names == [".dockerignore", "Dockerfile", "compose.yaml"]
