"""The site of one run differs from its site file by what was asked for."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rodeo.kinds import kinds_of
from rodeo.lab.config import Pose2
from rodeo.site.config import Site
from rodeo_cli.experiment import PAPER
from rodeo_experiments import site as experiment_site
from rodeo_experiments.errors import ExperimentFailed, NoFreePlace
from rodeo_experiments.lab import keep_clear
from rodeo_experiments.site import Begun, Variation, site_again, write_site
from tests.support.site import LAB


def test_a_run_has_its_own_data_and_ports_and_otherwise_the_sites_values(tmp_path: Path) -> None:
    base, site = Site.load(PAPER), Site.load(write_site(PAPER, tmp_path / "run", Variation()))
    assert site.data_dir.is_relative_to(tmp_path)
    assert site.chain.url != base.chain.url
    same = ("clock", "agent", "experiment", "robots", "items", "economy", "kinds")
    assert {name: getattr(site, name) for name in same} == {name: getattr(base, name) for name in same}


def test_a_run_that_continues_differs_by_the_port_of_its_chain_only(tmp_path: Path) -> None:
    before = Site.load(path := write_site(PAPER, tmp_path / "run", Variation(seed=9)))
    after = site_again(path)
    assert after.chain.url != before.chain.url
    chain = after.chain.model_copy(update={"url": before.chain.url})
    assert after.model_copy(update={"chain": chain}) == before


def test_seed_days_robots_tariff_and_chain_are_varied(tmp_path: Path) -> None:
    tariff = tmp_path / "tariff.csv"
    tariff.write_text("from_hour,eur_kwh\n0,0.1\n12,0.4\n")
    vary = Variation(seed=9, days=1, robots=2, tariff=tariff, chain="anvil")
    site = Site.load(write_site(PAPER, tmp_path / "run", vary))
    assert site.experiment is not None
    assert (site.clock.seed, site.experiment.days, site.chain.backend) == (9, 1, "anvil")
    assert site.experiment.arrivals == 17  # as many a day
    assert [one.from_hour for one in site.economy.electricity] == [0, 12]
    first, second = site.robots
    assert (first.name, second.name) == ("panther1", "panther2")
    assert second.working_hours == first.working_hours
    assert math.dist((first.pose.x_m, first.pose.y_m), (second.pose.x_m, second.pose.y_m)) > 1.2


@pytest.mark.parametrize(
    "rows",
    ["", "0,nan\n", "25,0.1\n", "0,-1\n", "noon,0.1\n", "0\n"],
    ids=lambda rows: rows.strip() or "none",
)
def test_what_is_no_tariff_is_refused(tmp_path: Path, rows: str) -> None:
    (tmp_path / "tariff.csv").write_text(f"from_hour,eur_kwh\n{rows}")
    with pytest.raises(ExperimentFailed, match="cannot read the tariff"):
        write_site(PAPER, tmp_path / "run", Variation(tariff=tmp_path / "tariff.csv"))


def test_robots_that_rest_leave_each_other_a_way_to_bin_and_dock(tmp_path: Path) -> None:
    usual = Site.load(PAPER)
    # Between desk and wall, where nobody gets past to the dock.
    assert not keep_clear(usual, [usual.robots[0].pose, Pose2(x_m=5.0, y_m=1.0)])
    for seed in range(3):
        site = Site.load(write_site(PAPER, tmp_path / str(seed), Variation(seed=seed, robots=2)))
        assert keep_clear(site, [robot.pose for robot in site.robots])


def test_more_robots_than_the_room_holds_are_refused_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment_site, "_TRIES", 3)
    with pytest.raises(NoFreePlace, match=r"larger lab\.size_m") as refused:
        write_site(PAPER, tmp_path / "run", Variation(robots=8))
    assert refused.value.details["robots"] == 8


def test_the_papers_pace_is_slower(tmp_path: Path) -> None:
    usual, slow = Site.load(PAPER), Site.load(write_site(PAPER, tmp_path / "run", Variation(slow=True)))
    assert slow.robots[0].limits.cruise_m_s < usual.robots[0].limits.cruise_m_s
    # An arm that passes the bin's camera slowly is taken for another item.
    assert slow.robots[0].limits.joint_rad_s == usual.robots[0].limits.joint_rad_s


def test_the_calibrated_run_differs_by_base_load_and_pace_alone(tmp_path: Path) -> None:
    usual = Site.load(PAPER)
    site = Site.load(write_site(PAPER, tmp_path / "run", Variation(slow=True, calibrated=True)))
    (ours,), (theirs,) = usual.robots, site.robots
    assert (ours.battery.idle_power_w, theirs.battery.idle_power_w) == (45, 115)
    assert theirs.battery.model_copy(update={"idle_power_w": 45}) == ours.battery
    assert theirs.model_copy(update={"battery": ours.battery, "limits": ours.limits}) == ours
    same = ("clock", "agent", "experiment", "items", "economy", "kinds", "docks", "lab")
    assert {name: getattr(site, name) for name in same} == {name: getattr(usual, name) for name in same}


def test_nothing_that_people_leave_is_listed_and_all_else_that_differs_is_in_the_site_file(
    tmp_path: Path,
) -> None:
    usual, site = Site.load(PAPER), Site.load(write_site(PAPER, tmp_path / "run", Variation(unlisted=True)))
    assert (site.items, site.things) == ([], usual.items)
    assert usual.experiment is not None
    agent = usual.agent.model_copy(update=usual.experiment.unlisted["agent"])
    assert site.agent == agent != usual.agent
    same = ("clock", "experiment", "robots", "economy", "kinds", "docks", "lab")
    assert {name: getattr(site, name) for name in same} == {name: getattr(usual, name) for name in same}
    # An auditor that this command plays would only say again what the oracle proposes.
    (kind,) = (one for one in site.kinds if one.name == usual.experiment.kind)
    assert kind.oracle_below_iec > kinds_of(site)[kind.name].price_iec


def test_a_site_that_names_no_calibrated_base_load_is_refused(tmp_path: Path) -> None:
    base = tmp_path / "site.toml"
    base.write_text(
        PAPER.read_text()
        .replace('"lab.toml"', f'"{PAPER.with_name("lab.toml")}"')
        .replace("calibrated_idle_power_w = 115\n", "")
    )
    with pytest.raises(ExperimentFailed, match=r"calibrated_idle_power_w"):
        write_site(base, tmp_path / "run", Variation(calibrated=True))


def test_a_site_without_an_experiment_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExperimentFailed):
        write_site(LAB, tmp_path / "run", Variation())


def test_a_run_goes_on_only_with_what_it_was_begun_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ExperimentFailed):
        Begun.load(tmp_path, PAPER, {})
    Begun.now(PAPER, {"seed": 7, "pace": None, "arrivals": "a.csv"}, [1.5]).save(tmp_path)
    for given in ({}, {"seed": None}, {"seed": 7, "pace": None, "arrivals": "a.csv"}):
        assert Begun.load(tmp_path, PAPER, given).times_s == [1.5]
    for given, name in (({"seed": 8}, "--seed"), ({"pace": "paper"}, "--pace"), ({"days": 2}, "--days")):
        with pytest.raises(ExperimentFailed, match=name):
            Begun.load(tmp_path, PAPER, given)
    monkeypatch.setenv("RODEO__ECONOMY__INITIAL_IEC", "1")
    with pytest.raises(ExperimentFailed, match="RODEO__ECONOMY__INITIAL_IEC"):
        Begun.load(tmp_path, PAPER, {})


def test_a_complete_run_is_reported_again_by_other_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Begun.now(PAPER, {}, [1.5]).save(tmp_path)
    monkeypatch.setattr("rodeo_experiments.site.code_sha256", lambda: "another")
    with pytest.raises(ExperimentFailed, match="the code has changed"):
        Begun.load(tmp_path, PAPER, {})
    assert Begun.load(tmp_path, PAPER, {}, complete=True).times_s == [1.5]


def test_a_run_does_not_go_on_once_its_site_file_has_changed(tmp_path: Path) -> None:
    base = tmp_path / "base.toml"
    base.write_text(f'extends = "{PAPER}"\n')
    Begun.now(base, {"site": str(base)}, []).save(tmp_path)
    Begun.load(tmp_path, PAPER, {})
    base.write_text(f'extends = "{PAPER}"\n[agent]\ncharge_below = 0.4\n')
    with pytest.raises(ExperimentFailed, match="the site file has changed"):
        Begun.load(tmp_path, PAPER, {})
