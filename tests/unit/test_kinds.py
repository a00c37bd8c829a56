"""A kind of work is found by its name, says who judges it, and brings nothing with it that is not needed."""

from __future__ import annotations

import subprocess
import sys
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from rodeo import kinds
from rodeo.errors import ConfigError, InvalidRequest
from rodeo.kinds import Kind, KindError, kinds_of, place_problems, with_place
from rodeo.lab.config import PlaceConfig, Pose2
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB

WATERING = """[[kinds]]
name = "plant_watering"
title = "Water the plants"
judge = "auditor"
price_iec = 7
execution_window_s = 600
parameters = { type = "object", required = ["room"], properties = { room = { type = "string" } } }
"""
ORDER = {"robot": "panther1", "soc_from": 0.5, "soc_target": 0.9}


def site_with(folder: Path, kinds_: str) -> Site:
    path = folder / "site.toml"
    path.write_text(f'extends = "{LAB}"\ndata_dir = "data"\n{kinds_}')
    return Site.load(path)


def test_a_kind_that_nobody_installed_is_refused_with_those_that_are(tmp_path: Path) -> None:
    site = site_with(tmp_path, '[[kinds]]\nname = "window_cleaning"\n')
    with pytest.raises(KindError) as refused:
        kinds_of(site)
    assert refused.value.details["kind"] == "window_cleaning"
    assert "waste_disposal" in refused.value.details["installed"]


def test_only_kinds_that_the_site_file_lists_are_known(tmp_path: Path) -> None:
    assert list(kinds_of(site_with(tmp_path, WATERING))) == ["plant_watering"]
    assert list(kinds_of(Site.load(LAB))) == ["waste_disposal", "battery_charging"]


def test_no_charge_may_cost_more_by_the_rates_than_a_task_pays(tmp_path: Path) -> None:
    """Nobody would deliver it, and the robot would stand still."""
    charging = '[[kinds]]\nname = "battery_charging"\nrates = [{ from_hour = 0, iec = 250 }]\n'
    with pytest.raises(KindError, match="raise price_iec") as refused:
        kinds_of(site_with(tmp_path, charging))
    assert Decimal(refused.value.details["full_charge_iec"]) > 200
    (kind,) = kinds_of(site_with(tmp_path, charging + "price_iec = 400\n")).values()
    assert [(one.from_hour, one.iec) for one in kind.rates] == [(0, 250)]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("rates = [{ from_hour = 0, iec = 0 }]", "write more than 0"),
        ("rates = [{ from_hour = 24, iec = 1 }]", "write at most 23"),
        ("rates = [{ from_hour = 6, iec = 1 }, { from_hour = 6, iec = 2 }]", "two rates begin at hour 6"),
        ('judge = "auditor"\nrates = [{ from_hour = 0, iec = 1 }]', "remove rates"),
    ],
)
def test_wrong_rates_are_refused(tmp_path: Path, wrong: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        site_with(tmp_path, f'[[kinds]]\nname = "battery_charging"\n{wrong}\n')


def test_a_kind_that_measures_no_quantity_has_no_rates(tmp_path: Path) -> None:
    with pytest.raises(KindError, match="measure no quantity"):
        kinds_of(
            site_with(tmp_path, '[[kinds]]\nname = "waste_disposal"\nrates = [{ from_hour = 0, iec = 1 }]\n')
        )


def test_a_table_declares_a_kind_that_people_do_and_judge(tmp_path: Path) -> None:
    found = kinds_of(site_with(tmp_path, WATERING))
    kind = found["plant_watering"]
    assert (kind.title, kind.judge, kind.execution_window_s, int(kind.price_iec)) == (
        "Water the plants", "auditor", 600, 7,
    )  # fmt: skip
    assert found.by_people("plant_watering")
    kind.validate({"room": "kitchen"})
    for wrong, field in (({}, "params"), ({"room": 3}, "room")):
        with pytest.raises(InvalidRequest) as refused:
            kind.validate(wrong)
        assert list(refused.value.details["fields"]) == [field]


@pytest.mark.parametrize(
    "table",
    [
        'name = "plant_watering"\ntitle = "Water the plants"',
        'name = "plant_watering"\nparameters = { type = "object" }',
        'name = "plant_watering"\njudge = "oracle"',
        'name = "Plant watering"\njudge = "auditor"',
        'name = "waste_disposal"\n[[kinds]]\nname = "waste_disposal"',
    ],
    ids=["no judge", "no judge of a schema", "an oracle without checks", "no name", "twice"],
)
def test_a_table_that_leaves_something_open_is_refused(tmp_path: Path, table: str) -> None:
    with pytest.raises(ConfigError) as refused:
        site_with(tmp_path, f"[[kinds]]\n{table}\n")
    assert any(field.startswith("kinds") for field in refused.value.details["fields"])


def test_a_kind_without_checks_cannot_have_the_oracle_judge_it() -> None:
    with pytest.raises(KindError):
        Kind(name="guessing", title="Guess", description="", judge="oracle")


def test_what_the_site_file_says_otherwise_holds(tmp_path: Path) -> None:
    table = '[[kinds]]\nname = "waste_disposal"\nprice_iec = 3\n'
    table += "execution_window_s = 60\n"
    kind = kinds_of(site_with(tmp_path, table))["waste_disposal"]
    assert (int(kind.price_iec), kind.execution_window_s) == (3, 60)
    assert kind.params is kinds.load("waste_disposal").params


def test_people_have_half_an_hour_to_accept_and_no_grace_period_is_over_half_of_the_shortest_window(
    tmp_path: Path,
) -> None:
    tables = (
        '[[kinds]]\nname = "window_cleaning"\njudge = "auditor"\n[[kinds]]\nname = "battery_charging"\n'
        '[[kinds]]\nname = "waste_disposal"\n'
    )
    graces = {name: kind.grace_period_s for name, kind in kinds_of(site_with(tmp_path, tables)).items()}
    assert graces == {"window_cleaning": 1800, "battery_charging": 1800, "waste_disposal": 180}
    (short,) = kinds_of(
        site_with(
            tmp_path, 'robots = []\ndocks = []\n[[kinds]]\nname = "waste_disposal"\nmin_window_s = 100\n'
        )
    ).values()
    assert short.grace_period_s == 50
    with pytest.raises(KindError, match="at most half of the shortest") as refused:
        kinds_of(site_with(tmp_path, tables + "min_window_s = 600\ngrace_s = 310\n"))
    assert refused.value.details["max_s"] == 300


def test_care_that_a_robot_asks_for_is_of_a_kind_that_is_listed(tmp_path: Path) -> None:
    care = 'kind = "wheel_cleaning"\nevery_km = 5\nreward_iec = 50\ndescription = "Clean my wheels"\n'
    with pytest.raises(ConfigError) as refused:
        site_with(tmp_path, f"[[agent.maintenance]]\n{care}")
    assert 'judge = "auditor"' in str(refused.value.details["fields"])


@pytest.mark.parametrize("name", ["battery_charging", "waste_disposal"])
def test_reading_a_declaration_imports_neither_mujoco_nor_opencv(name: str) -> None:
    code = (
        "import sys\nfrom rodeo.kinds import load\n"
        f"assert load({name!r}).schema['properties']\n"
        "print(sorted({'mujoco', 'cv2', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["battery_charging", "waste_disposal"])
def test_an_example_is_of_its_kind(name: str) -> None:
    kind = kinds.load(name)
    kind.validate(kind.example)
    assert kind.problems(Site.load(LAB), kind.example) == {}


@pytest.mark.parametrize(
    ("name", "said", "added"),
    [
        ("waste_disposal", {"item_id": "item1"}, {"x_m", "y_m"}),
        ("waste_disposal", {"item_id": "item1", "x_m": 1.0, "y_m": 1.0}, set()),
        (
            "battery_charging",
            {"robot": "panther1", "soc_from": 0.5, "soc_target": 0.9},
            {"dock", "energy_wh"},
        ),
        ("battery_charging", {"robot": "nobody", "soc_from": 0.5, "soc_target": 0.9}, {"dock"}),
    ],
)
def test_what_follows_from_the_rest_is_filled_in_and_nothing_said_is_changed(
    name: str, said: dict[str, Any], added: set[str]
) -> None:
    whole = kinds.load(name).complete(Site.load(LAB), said)
    assert whole.items() >= said.items() and set(whole) - set(said) == added


def test_a_task_names_a_place_and_says_on_chain_where_that_is() -> None:
    door = PlaceConfig(name="door", pose=Pose2(x_m=2.0, y_m=1.5))
    site = Site.load(LAB).model_copy(update={"places": [door]})
    there = with_place(site, {"place": "door"})
    assert there == {"place": "door", "x_m": 2.0, "y_m": 1.5}
    assert with_place(site, {"x_m": 9.0}) == {"x_m": 9.0}
    assert place_problems(site, there) == {} == place_problems(site, {"x_m": 9.0})
    elsewhere = with_place(site, {"place": "door", "x_m": 9.0})
    assert place_problems(site, elsewhere) == {"place": "door is at x 2 y 1.5: leave out x_m and y_m"}
    assert place_problems(site, {"place": "dor"}) == {"place": "choose one of this site: door"}
