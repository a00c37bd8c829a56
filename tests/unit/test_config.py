"""The site file: merging, overrides, and errors that name what is wrong."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from rodeo.errors import ConfigError
from rodeo.lab.config import RobotConfig
from rodeo.site.config import Site
from rodeo.site.faults import faults
from rodeo.site.names import bridge_wallets, oracle_names, oracle_process, votes_needed
from rodeo.site.sections import GovernanceConfig
from rodeo_cli.site_check import check
from tests.support.site import LAB


def lab_with(folder: Path, lines: str) -> Path:
    """The repository's lab, with these lines of a site file."""
    path = folder / "site.toml"
    path.write_text(f'extends = "{LAB}"\n{lines}\n')
    return path


def refused(path: Path) -> dict[str, str]:
    """What is wrong with each field of a site file."""
    with pytest.raises(ConfigError) as caught:
        Site.load(path)
    fields: dict[str, str] = caught.value.details["fields"]
    return fields


def test_the_lab_of_the_repository_is_valid() -> None:
    site = Site.load(LAB)
    assert site.robot("panther1").name == "panther1"


@pytest.mark.parametrize("name", sorted(path.name for path in LAB.parent.glob("*.toml")))
def test_every_site_of_the_repository_is_without_findings(name: str) -> None:
    assert check(LAB.with_name(name)) == []


def test_a_public_test_network_gets_what_new_organizations_have() -> None:
    public, demo = Site.load(LAB.with_name("testnet.toml")), Site.load(LAB)
    assert (public.chain.backend, public.clock.speed, public.clock.idle_speed) == ("external", 1, 1)
    assert demo.governance.delay_s == 0
    default = GovernanceConfig()
    assert (public.governance.delay_s, public.governance.terms) == (default.delay_s, default.terms)
    assert public.governance.budgets == default.budgets


def test_a_site_extends_another_and_overrides_single_values(tmp_path: Path) -> None:
    path = lab_with(tmp_path, "clock.speed = 3.0")
    site = Site.load(path)
    assert site.clock.speed == 3.0
    assert site.clock.idle_speed == Site.load(LAB).clock.idle_speed


def test_a_robot_is_called_by_its_name_unless_the_site_says_otherwise(tmp_path: Path) -> None:
    robot = Site.load(LAB).robots[0]
    assert (robot.namespace, robot.wallet, robot.body, robot.kinematics) == (
        "panther1",
        "panther1",
        "sim",
        None,
    )
    path = tmp_path / "site.toml"
    path.write_text(f"""extends = "{LAB}"
[[robots]]
name = "arthur"
namespace = "fleet/a1"
body = "ros2"
wallet = "arthurs-purse"
kinematics = "models/arthur.urdf"
pose = {{ x_m = 1.4, y_m = 1.3 }}
""")
    robot = Site.load(path).robot("arthur")
    assert (robot.namespace, robot.wallet, robot.body) == ("fleet/a1", "arthurs-purse", "ros2")
    assert robot.kinematics == tmp_path / "models" / "arthur.urdf", "seen from the site file"


@pytest.mark.parametrize("field", ["name", "namespace"])
def test_two_robots_cannot_be_called_the_same(field: str) -> None:
    site = Site.load(LAB)
    first = site.robots[0].model_dump()
    second = {**first, "name": "other", "namespace": "other", field: first[field]}
    both = Site.model_validate({**site.model_dump(by_alias=True), "robots": [first, second]})
    assert f"two robots have the same {field}" in faults(both)["robots", 1, field]


@pytest.mark.parametrize(
    ("variable", "meant"),
    [("RODEO__CHIAN__URL", "RODEO__CHAIN"), ("RODEO__CHAIN__ULR", "RODEO__CHAIN__URL"), ("RODEO__XYZ", None)],
)
def test_a_variable_that_means_no_field_is_an_error(
    monkeypatch: pytest.MonkeyPatch, variable: str, meant: str | None
) -> None:
    monkeypatch.setenv(variable, "http://chain.example:1")
    with pytest.raises(ConfigError, match=variable) as refused:
        Site.load(LAB)
    assert (meant is None) is ("meant" not in str(refused.value))
    assert meant is None or f"is {meant} meant?" in str(refused.value)


def test_the_environment_overrides_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RODEO__CHAIN__URL", "http://chain.example:1")
    assert Site.load(LAB).chain.url == "http://chain.example:1"


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ('chain.url = "foo"', "chain.url"),
        ('chain.url = "http://"', "chain.url"),
        ('chain.url = "http://127.0.0.1:0"', "chain.url"),
        ('chain.url = "ws://127.0.0.1:8545"', "chain.url"),
        ('chain.websocket_url = "http://127.0.0.1:8545"', "chain.websocket_url"),
        ('store.url = "store"', "store.url"),
        ('store.allowed = [""]', "store.allowed.0"),
        ('console.host = ""', "console.host"),
        ("clock.speed = inf", "clock.speed"),
        ("bridge.stuck_s = nan", "bridge.stuck_s"),
        ("lab.size_m = [inf, 5.0]", "lab.size_m.0"),
    ],
)
def test_what_is_no_address_and_no_number_is_an_error(tmp_path: Path, line: str, field: str) -> None:
    path = lab_with(tmp_path, line)
    assert list(refused(path)) == [field]


def test_a_data_directory_without_a_name_is_an_error(tmp_path: Path) -> None:
    path = lab_with(tmp_path, 'data_dir = ""')
    with pytest.raises(ConfigError, match="data_dir: an empty text names no file or folder"):
        Site.load(path)


def test_an_unknown_setting_is_named(tmp_path: Path) -> None:
    path = lab_with(tmp_path, "clock.sped = 3.0")
    assert list(refused(path)) == ["clock.sped"]


def test_a_file_that_extends_itself_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text('extends = "site.toml"\n')
    with pytest.raises(ConfigError, match="extends itself"):
        Site.load(path)


@pytest.mark.parametrize("text", ["= 1", "\x00", 'org = "lab'])
def test_a_file_that_is_not_toml_is_an_error(tmp_path: Path, text: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        Site.load(path)
    assert caught.value.details["path"] == str(path)


@pytest.mark.parametrize(("what", "known"), [("robot", "panther1"), ("bin", "itrash"), ("dock", "dock1")])
def test_an_unknown_robot_bin_or_dock_is_an_error_that_names_those_there_are(what: str, known: str) -> None:
    find = getattr(Site.load(LAB), what)
    assert find(known).name == known
    with pytest.raises(ConfigError) as caught:
        find("nobody")
    assert caught.value.details == {what: "nobody", f"{what}s": [known]}


@pytest.mark.parametrize(
    ("places", "field", "text"),
    [
        ([("door", 1.0), ("door", 2.0)], "places.1.name", "two things in the lab are called"),
        ([("dock1", 1.0)], "places.0.name", "two things in the lab are called"),
        ([("door", 71.0)], "places.0.pose", "door is outside the room"),
    ],
)
def test_a_place_has_a_name_of_its_own_and_is_in_the_room(
    tmp_path: Path, places: list[tuple[str, float]], field: str, text: str
) -> None:
    site = tmp_path / "site.toml"
    tables = [f'[[places]]\nname = "{name}"\npose = {{ x_m = {x_m}, y_m = 1.0 }}' for name, x_m in places]
    site.write_text("\n".join([f'extends = "{LAB}"', *tables]))
    assert text in refused(site)[field]


def test_a_site_without_bins_and_docks_is_one(tmp_path: Path) -> None:
    site = lab_with(tmp_path, "bins = []\ndocks = []\nkinds = []")
    assert (Site.load(site).bins, Site.load(site).docks) == ([], [])


def test_a_camera_folder_is_beside_the_file_that_says_it(tmp_path: Path) -> None:
    camera = 'camera = { source = "folder", address = "pictures" }'
    site = lab_with(tmp_path, f"[[bins]]\npose = {{ x_m = 5.2, y_m = 4.45 }}\n{camera}")
    assert Site.load(site).bins[0].camera.address == str(tmp_path / "pictures")


def test_the_data_directory_is_beside_the_file_that_says_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "base.toml").write_text(f'extends = "{LAB}"\ndata_dir = "data"\n')
    (tmp_path / "elsewhere" / "site.toml").write_text('extends = "../base.toml"\n')
    monkeypatch.chdir("/")
    assert Site.load(tmp_path / "elsewhere" / "site.toml").data_dir == tmp_path / "data"


def test_a_chain_elsewhere_cannot_follow_a_clock_that_runs_faster(tmp_path: Path) -> None:
    path = lab_with(tmp_path, 'chain.backend = "external"')
    with pytest.raises(ConfigError, match=r"clock\.speed"):
        Site.load(path)
    path.write_text(path.read_text() + "clock.speed = 1\nclock.idle_speed = 1\n")
    assert Site.load(path).chain.backend == "external"


def test_a_simulated_site_begins_when_its_file_says(tmp_path: Path) -> None:
    path = lab_with(tmp_path, "clock.start = 2026-05-04T10:00:00+02:00")
    assert Site.load(path).clock.begin_s() == 1_777_881_600
    path.write_text(path.read_text() + "clock.speed = 1\nclock.idle_speed = 1\n")
    with pytest.raises(ConfigError, match="start"):
        Site.load(path)


@pytest.mark.parametrize(
    "start", ["1969-12-31T23:59:59Z", "2038-01-19T03:14:08Z", "2040-05-04T08:00:00+02:00"]
)
def test_a_site_does_not_begin_when_ros_has_no_time(tmp_path: Path, start: str) -> None:
    path = lab_with(tmp_path, f"clock.start = {start}")
    with pytest.raises(ConfigError, match="between 1970 and 2038-01-19"):
        Site.load(path)


def test_a_site_that_is_swapped_to_the_wall_by_one_line_has_no_speeds_left(tmp_path: Path) -> None:
    path = lab_with(tmp_path, 'clock.source = "wall"')
    assert Site.load(LAB).clock.idle_speed > 1
    clock = Site.load(path).clock
    assert (clock.speed, clock.idle_speed) == (1, 1)
    path.write_text(path.read_text() + 'chain.backend = "external"\n')
    assert Site.load(path).chain.backend == "external"


def three(tables: str) -> str:
    return tables + "".join(f'[[oracles]]\nname = "{name}"\n' for name in ("anna", "bert", "carl"))


def disputed(table: str) -> str:
    people = "".join(f'[[participants]]\nname = "{name}"\n' for name in "pqrstuv")
    return f"{people}[disputes]\n{table}\n"


APPEAL = 'judges = ["s", "t", "u", "v"]\nvotes = 4\nwindow_s = 600\ndecision_s = 900'


def appealed(table: str) -> str:
    return disputed(f'judges = ["p", "q", "r"]\nvotes = 3\n[disputes.appeal]\n{table}')


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        ('[[oracles]]\nname = "anna"\n', "oracles"),
        ('[[oracles]]\nname = "anna"\n[[oracles]]\nname = "anna"\n', "oracles.1.name"),
        (three('[[oracles]]\nname = "dora"\nowner = "nobody"\n'), "oracles.0.owner"),
        (three("oracle.panel = 4\n"), "oracle.panel"),
        (three('[[kinds]]\nname = "waste_disposal"\nvotes = 1\n'), "kinds.0.votes"),
        (three('[[kinds]]\nname = "waste_disposal"\nvotes = 4\n'), "kinds.0.votes"),
        ('[[kinds]]\nname = "waste_disposal"\nvotes = 1\n', "kinds.0.votes"),
        (disputed('judges = ["p", "q", "r"]\nvotes = 3'), "disputes"),
        (three(disputed('judges = ["p", "q", "nobody"]\nvotes = 3')), "disputes.judges.2"),
        (three(disputed('judges = ["p", "q", "r"]\nvotes = 4')), "disputes.votes"),
        (three(disputed('judges = ["p", "q", "r"]\nvotes = 2')), "disputes.votes"),  # as many as oracles
        (
            three(disputed('judges = ["p", "q", "r"]\nvotes = 3\nwindow_s = 90000')),
            "economy.verdict_window_s",
        ),
        (three(appealed('judges = ["s", "t", "u", "nobody"]\nvotes = 4')), "disputes.appeal.judges.3"),
        (three(appealed('judges = ["s", "t", "u", "r"]\nvotes = 4')), "disputes.appeal.judges.3"),  # twice
        (three(appealed('judges = ["s", "t", "u", "v"]\nvotes = 3')), "disputes.appeal.votes"),
        (three(appealed('judges = ["s", "t", "u", "v"]\nvotes = 5')), "disputes.appeal.votes"),
        (
            three(appealed('judges = ["s", "t", "u", "v"]\nvotes = 4\nstake_iec = 20')),
            "disputes.appeal.stake_iec",
        ),
        (
            three(appealed('judges = ["s", "t", "u", "v"]\nvotes = 4\nwindow_s = 90000')),
            "economy.verdict_window_s",
        ),
    ],
)
def test_oracles_that_could_not_agree_are_an_error(tmp_path: Path, tables: str, field: str) -> None:
    demo = 'demo = { kind = "waste_disposal" }\n' if "[[kinds]]" in tables else ""
    path = lab_with(tmp_path, f"{demo}{tables}")
    assert field in refused(path)


def test_votes_that_nobody_could_cast_are_an_error(tmp_path: Path) -> None:
    path = lab_with(tmp_path, '[governance]\ndelay_s = 60\nkind = "vote"')
    assert "governance.members" in refused(path)


@pytest.mark.parametrize(
    ("line", "field", "text"),
    [
        ("verdict_window_s = 59", "verdict_window_s", "at least 60 s"),
        ("verdict_window_s = 2_592_001", "audit_window_s", "2592061 s together"),
        ("audit_window_s = 2_592_000", "audit_window_s", "2764800 s together"),
        ("audit_window_s = 2_592_001", "audit_window_s", "write at most 2592000"),
    ],
)
def test_a_case_that_no_judge_takes_is_an_error(tmp_path: Path, line: str, field: str, text: str) -> None:
    audit = "" if field in line else "\naudit_window_s = 60"
    path = lab_with(tmp_path, f"[economy]\n{line}{audit}")
    assert text in refused(path)[f"economy.{field}"]


LIMIT = "[bridge.limits]\nfinder.daily_iec = 500\norganization.daily_iec = 500\npanther1.daily_iec = 500\n"


@pytest.mark.parametrize(
    ("poster", "more", "text"),
    [
        ("finder", LIMIT, ""),
        ("organization", LIMIT, ""),
        ("finder", "", "set bridge.limits.finder.daily_iec"),
        ("panther1", LIMIT, "who is no robot"),
        ("oracle", LIMIT, "no wallet of a participant oracle"),
        ("finder", LIMIT + '[[bridges]]\nname = "other"\nwallets = ["finder"]', "no wallet of a participant"),
        ("finder", LIMIT.replace("[bridge", 'kinds = ["waste_disposal"]\n[bridge'), "nobody pays himself"),
    ],
)
def test_who_posts_what_robots_see_is_no_robot_and_has_a_limit(
    tmp_path: Path, poster: str, more: str, text: str
) -> None:
    kind = f'[[kinds]]\nname = "waste_disposal"\npost_seen_as = "{poster}"\n'
    path = lab_with(tmp_path, f'{kind}[[participants]]\nname = "finder"\n{more}')
    if not text:
        assert Site.load(path).kinds[0].post_seen_as == poster
        return
    assert text in refused(path)["kinds.0.post_seen_as"]


TOKEN = 'economy.token = { address = "0xA0b86991c6218b36c1d19D4a2e9Eb0cE3606eB48", decimals = 6 }\n'


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("governance.terms.bond_iec = 0.0000001", "governance.terms.bond_iec"),
        ("governance.budgets.operator.iec = 0.0000001", "governance.budgets.operator.iec"),
        ("bridge.limits.panther1.daily_iec = 1.2345678", "bridge.limits.panther1.daily_iec"),
        (
            'demo.kind = "dusting"\n[[kinds]]\nname = "dusting"\njudge = "auditor"\nprice_iec = 1.2345678',
            "kinds.0.price_iec",
        ),
        ("governance.terms.bond_iec = 0.000001", None),
    ],
)
def test_amounts_finer_than_the_token_are_an_error(tmp_path: Path, line: str, field: str | None) -> None:
    path = lab_with(tmp_path, f"{TOKEN}{line}")
    if field is None:
        assert Site.load(path).economy.currency.decimals == 6
        return
    assert "more than 6 decimals" in refused(path)[field]


def test_of_several_oracles_more_than_half_of_the_panel_agree_unless_the_kind_says_more(
    tmp_path: Path,
) -> None:
    kinds = '[[kinds]]\nname = "waste_disposal"\nvotes = 3\n[[kinds]]\nname = "battery_charging"\n'
    path = lab_with(tmp_path, three(kinds))
    site = Site.load(path)
    assert (votes_needed(site, "waste_disposal"), votes_needed(site, "battery_charging")) == (3, 2)
    assert [oracle_process(site, name) for name in oracle_names(site)] == [
        "oracle.anna",
        "oracle.bert",
        "oracle.carl",
    ]
    assert oracle_names(Site.load(LAB)) == ["oracle"]


def test_an_appeal_takes_more_time_and_what_is_left_out_costs_twice_the_stake(tmp_path: Path) -> None:
    path = lab_with(tmp_path, three(appealed(APPEAL)))
    wanted = Site.load(path).disputes
    assert wanted is not None and wanted.appeal is not None
    assert [one.votes for one in wanted.instances] == [3, 4]
    assert (wanted.stake_iec, wanted.appeal.stake_iec) == (20, 40)
    assert wanted.longest_s == 3600 + 24 * 3600 + 600 + 900


def test_where_there_are_two_bridges_the_second_has_the_oracles_wallets(tmp_path: Path) -> None:
    judges = '[[bridges]]\nname = "judges"\n'
    path = lab_with(tmp_path, f'participants = [{{ name = "alice" }}]\n{judges}')
    assert bridge_wallets(Site.load(path)) == {
        "bridge": ["organization", "panther1", "alice"],
        "bridge.judges": ["oracle"],
    }
    path.write_text(f'extends = "{LAB}"\n{three(judges)}')
    several = bridge_wallets(Site.load(path))
    assert several == {"bridge": ["organization", "panther1"], "bridge.judges": ["anna", "bert", "carl"]}
    assert bridge_wallets(Site.load(LAB)) == {"bridge": ["organization", "panther1", "oracle"]}


def test_a_mistyped_payout_address_is_an_error() -> None:
    robot = {"pose": {"x_m": 1, "y_m": 1, "yaw_rad": 0}}
    address = "0x70997970C51812dc3A010C7d01b50e0d17dc79C8"
    for written in (address, address.lower()):
        assert RobotConfig.model_validate({**robot, "payout": written}).payout == address
    for mistyped in (address.replace("dc79", "dc97"), address[:-1], "alice"):
        with pytest.raises(ValidationError, match="payout"):
            RobotConfig.model_validate({**robot, "payout": mistyped})
