"""`rodeo site check`: what is wrong in a site file, on which line, and what is meant instead."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rodeo.errors import ConfigError
from rodeo.lab.config import SHAPE_NAMES
from rodeo.lab.items import SHAPES
from rodeo.site.config import Site
from rodeo_cli.site_check import check
from rodeo_cli.toml_lines import lines_of
from tests.support.site import LAB

Said = Callable[[str], list[str]]

REAL = LAB.with_name("reallab.toml")
HEAD = f"""extends = "{LAB}"
data_dir = "data"
"""


def item(name: str = "item1", kind: str = "metal", shape: str = "can", x_m: float = 4.6) -> str:
    """Five lines."""
    return f"""[[items]]
id = "{name}"
class = "{kind}"
shape = "{shape}"
pose = {{ x_m = {x_m}, y_m = 1.2 }}
"""


def robot(line: str) -> str:
    """Three lines, the last one of which is `line`."""
    return f"""[[robots]]
pose = {{ x_m = 1.4, y_m = 1.3 }}
{line}
"""


@pytest.fixture
def said(tmp_path: Path) -> Said:
    """What is found in a file that has this text after its first two lines."""

    def of(text: str) -> list[str]:
        path = tmp_path / "my.toml"
        path.write_text(HEAD + text)
        return [str(finding).replace(f"{tmp_path}/", "") for finding in check(path)]

    return of


def test_the_lab_that_comes_along_is_a_good_site() -> None:
    assert check(LAB) == []


BINS = '[[bins]]\nname = "{}"\npose = {{ x_m = 5.2, y_m = 4.45, yaw_rad = -1.5708 }}\nhttp_port = {}\n'
WRONG = [
    (
        '[governance]\nkind = "vote"\nmembers = ["panther1", "alice", "bob"]\ndelay_s = 0\n',
        6,
        "governance.delay_s: decisions by vote take effect after a delay: set more than 0",
    ),
    (
        '[governance]\nkind = "vote"\nmembers = ["panther2", "alice", "bob"]\ndelay_s = 9\n',
        5,
        'governance.members.0: nobody on this site is called panther2; is "panther1" meant?',
    ),
    (
        '[governance]\nkind = "vote"\ndelay_s = 9\nmembers = ["panther1", "organization", "panther1"]\n',
        6,
        "governance.members: 2 members cannot decide by vote: name at least 3",
    ),
    (
        item(x_m=14.6),
        7,
        "items.0.pose: item1 is outside the room: x_m is 14.6 of 0 to 7, y_m is 1.2 of 0 to 5 (lab.size_m)",
    ),
    (item(shape="cann"), 6, "items.0.shape: metal has no shape 'cann', only can and tin; is \"can\" meant?"),
    (item() + item(x_m=3.0), 9, 'items.1.id: two things in the lab are called "item1"'),
    (
        '[bin]\nname = "itrash"\npose = { x_m = 1, y_m = 4.5 }\n',
        3,
        "bin: a site has a list of bins: write [[bins]] above each\n"
        '[[bins]]\nname = "itrash"\npose = { x_m = 1, y_m = 4.5 }',
    ),
    (
        '[dock]\nname = "dock1"\n',
        3,
        'dock: a site has a list of docks: write [[docks]] above each\n[[docks]]\nname = "dock1"',
    ),
    (
        "[itrash]\nhttp_port = 8091\n",
        3,
        "itrash: each bin has its own page and camera: write under its [[bins]]\nhttp_port = 8091",
    ),
    (
        BINS.format("a", 8095) + BINS.format("b", 8095),
        10,
        "bins.1.http_port: port 8095 of 127.0.0.1 is already used by bins.0.http_port",
    ),
    (BINS.format("itrash", 0) * 2, 8, 'bins.1.name: two things in the lab are called "itrash"'),
    (
        BINS.format("Two", 0),
        4,
        'bins.0.name: write small letters, digits, _, beginning with a letter, not "Two"',
    ),
    ("chain.ulr = 1\n", 3, 'chain.ulr: no such key; is "url" meant?'),
    ("clock.sed = 7\n", 3, 'clock.sed: no such key; is "seed" meant?'),
    ("clock.seed = -1\n", 3, "clock.seed: write at least 0, not -1"),
    (
        robot('working_hours = ["08:00-12:00", "8-18"]'),
        5,
        "robots.0.working_hours.1: write hours like \"08:00-18:00\", not '8-18'",
    ),
    (
        robot('working_hours = ["08:00-12:00", "11:00-18:00"]'),
        5,
        'robots.0.working_hours: "08:00-12:00" and "11:00-18:00" overlap',
    ),
    (
        robot('working_hour = ["08:00-18:00"]'),
        5,
        'robots.0.working_hour: no such key; is "working_hours" meant?',
    ),
    (
        robot('interface = { gripper = "trajectory" }'),
        5,
        "robots.0.interface: robot_sim moves it, with an arm and the table of keys: write "
        'body = "ros2", or no interface',
    ),
    (
        robot('body = "ros2"\ninterface = { arm = false, gripper = "trajectory" }'),
        6,
        "robots.0.interface: a robot without an arm has no gripper: leave one of the two out",
    ),
    (
        robot('body = "ros2"\nkinematics = "site.toml"\ninterface = { arm = false }'),
        7,
        "robots.0.interface: kinematics describes an arm, and this robot has none: leave one of the two out",
    ),
    (
        robot('interface = { griper = "trajectory" }'),
        5,
        'robots.0.interface.griper: no such key; is "gripper" meant?',
    ),
    (
        robot("rates = { odom_hz = 20 }"),
        5,
        "robots.0.rates.odom_hz: write at least 50 Hz, not 20",
    ),
    (
        robot('timezone = "Europe/Berlim"'),
        5,
        "robots.0.timezone: there is no time zone 'Europe/Berlim'; they are named like \"Europe/Berlin\"; "
        'is "Europe/Berlin" meant?',
    ),
    (
        robot("battery.standby_power_w = -1"),
        5,
        "robots.0.battery.standby_power_w: write at least 0 W, not -1",
    ),
    ("consol.port = 1\n", 3, 'consol: no such key; is "console" meant?'),
    (
        item() + "participants = []\n",
        8,
        "items.0.participants: no such key here: participants belongs to the site itself, above the first "
        "[table] of the file (TOML puts what follows a table's header into that table)",
    ),
    (
        "[economy]\nelectricity = [\n { from_hour = 6, eur_kwh = 1 },\n { from_hour = 6, eur_kwh = 2 },\n]\n",
        6,
        "economy.electricity.1.from_hour: two electricity tariffs begin at hour 6",
    ),
    ("console.port = 8090\n", 3, "console.port: port 8090 of 127.0.0.1 is already used by bins.0.http_port"),
    (
        "[bridge.limits.pantehr1]\ndaily_iec = 1\n",
        3,
        'bridge.limits.pantehr1: nobody on this site is called pantehr1; is "panther1" meant?',
    ),
    (
        'participants = [{ name = "alice", address = "0x'
        + "a" * 40
        + '" }]\n[bridge.limits.alice]\ndaily_iec = 1\n',
        4,
        "bridge.limits.alice: alice signs for itself, so no bridge limits what it spends",
    ),
    (
        '[bridge]\nshared_wallets = ["organization", "pantehr1"]\n',
        4,
        'bridge.shared_wallets.1: nobody on this site is called pantehr1; is "panther1" meant?',
    ),
    (
        '[[bridges]]\nname = "judges"\nwallets = ["oracel"]\n',
        5,
        'bridges.0.wallets.0: nobody on this site is called oracel; is "oracle" meant?',
    ),
    (
        '[[bridges]]\nname = "second"\nwallets = ["organization", "oracle"]\n',
        5,
        "bridges.0.wallets: the wallets of the organization and of its oracle are both on second: whoever "
        "takes over that computer can post tasks and accept their proofs; give them to different [[bridges]]",
    ),
    (
        '[[bridges]]\nname = "judges"\n[[bridges]]\nname = "more"\n',
        5,
        "bridges.1: judges manages the wallet of oracle: list the wallets of each",
    ),
    ('[[bridges]]\nname = "bridge"\n', 4, 'bridges.0.name: two bridges are called "bridge"'),
    (
        'participants = [{ name = "alice" }, { name = "alice" }]\n',
        3,
        'participants.1.name: two participants have the keystore "alice"',
    ),
]


@pytest.mark.parametrize(("text", "line", "sentence"), WRONG)
def test_what_no_site_can_be_is_named_with_its_line_and_refused(
    said: Said, tmp_path: Path, text: str, line: int, sentence: str
) -> None:
    assert f"my.toml:{line}: error: {sentence}" in said(text)
    with pytest.raises(ConfigError) as refused:
        Site.load(tmp_path / "my.toml")
    place, _, why = sentence.partition(": ")
    assert refused.value.details["fields"][place] == why


def test_postures_that_are_no_arms_and_a_model_without_one_are_errors(said: Said, tmp_path: Path) -> None:
    (five,) = said(robot("postures = { ready_rad = [0.0, -0.6, 0.9, 1.1, 0.0] }"))
    assert five.startswith(
        "my.toml:5: error: robots.0.postures.ready_rad: a posture has one angle for each joint"
    )
    assert "angles 5" in five and "wrist_rotate" in five
    (tmp_path / "cart.xml").write_text('<mujoco><worldbody><body name="base_link"/></worldbody></mujoco>')
    (cart,) = said(robot('kinematics = "cart.xml"'))
    assert cart.startswith("my.toml:5: error: robots.0.kinematics: not a usable robot")


def test_walls_may_meet_each_other_and_the_labs_own_and_nothing_else(said: Said) -> None:
    rooms = """[lab]
furniture = []
[[rooms]]
name = "west"
corner_m = [0.0, 0.0]
size_m = [3.5, 5.0]
doors = [{ wall = "east", at_m = 3.4 }]
[[rooms]]
name = "east"
corner_m = [3.5, 0.0]
size_m = [3.5, 2.0]
doors = [{ wall = "north", at_m = 0.9 }]
"""
    assert said(rooms) == []
    (found,) = said(rooms.replace("furniture = []", 'furniture = [{ name = "box", kind = "crate", '
        "pose = { x_m = 3.5, y_m = 1.0 }, size_m = [0.3, 0.3, 0.3] }]"))  # fmt: skip
    assert "overlaps box" in found


def test_robots_and_docks_need_a_kind_that_provides_energy(said: Said) -> None:
    """Also where the file forgets that its list replaces the one of the file that it extends."""
    wheels = '[[kinds]]\nname = "wheel_cleaning"\njudge = "auditor"\nprice_iec = 40\n'
    (found,) = said(wheels)
    assert "no kind provides energy, which robots and docks need" in found and "battery_charging" in found
    assert said(wheels + '[[kinds]]\nname = "battery_charging"\n') == []
    assert said("robots = []\ndocks = []\n" + wheels) == []


@pytest.mark.parametrize(("lacking", "kind"), [("bins", 0), ("docks", 1)])
def test_a_kind_of_work_needs_what_it_is_done_at(said: Said, lacking: str, kind: int) -> None:
    (finding,) = said(f"{lacking} = []\n")
    assert f"error: kinds.{kind}" in finding and finding.endswith(f"what the site lacks: write [[{lacking}]]")


DOUBTFUL = [
    (
        '[[bridges]]\nname = "panther1"\nwallets = ["panther1"]\n',
        3,
        "bridges: the wallets of the organization and of its oracle are both on the site's own bridge: "
        "whoever takes over that computer can post tasks and accept their proofs; give them to different "
        "[[bridges]]",
    ),
    (
        'lab.mocap_gripper = false\ndemo.params = { item_id = "", x_m = 3.0, y_m = 2.0 }\n',
        4,
        "demo.params: nobody could prove here what became of something without markers",
    ),
    (
        robot("battery = { standby_power_w = 50 }"),
        5,
        "robots.0.battery.standby_power_w: panther1 draws more power switched off (50 W) than idle (45 W)",
    ),
    (
        "clock.idle_speed = 0\n",
        3,
        "clock.idle_speed: the clock may jump over a task's whole grace period before its executor hears of "
        'it: list "bridge" in clock.holders, too',
    ),
    (
        '[[kinds]]\nname = "battery_charging"\n[[kinds]]\nname = "waste_disposal"\ngrace_s = 40\n',
        5,
        "kinds.1: a task of waste_disposal can be given back for 40 s of site time, and a process may need "
        "50 s for that, 5 s on the wall clock: lower clock.speed, or raise grace_s",
    ),
    (
        '[[kinds]]\nname = "battery_charging"\n[[kinds]]\nname = "waste_disposal"\n'
        '[[robots]]\nname = "panther1"\npose = { x_m = 1.4, y_m = 1.3 }\n'
        '[[robots]]\nname = "panther2"\npose = { x_m = 3.1, y_m = 2.2 }\n',
        5,
        "kinds.1: a task of waste_disposal can be given back for 180 s of site time, and a process may need "
        "2000 s for that, 5 s on the wall clock: lower clock.idle_speed, or raise grace_s",
    ),
    (
        '[[kinds]]\nname = "battery_charging"\n[[kinds]]\nname = "dusting"\njudge = "auditor"\n',
        5,
        "kinds.1: dusting has no price_iec, so an attempt counts up to 100 IEC in its provider's record: say "
        "what the work costs",
    ),
    (
        "".join(f'[[oracles]]\nname = "{name}"\n' for name in ("anna", "bert", "carl"))
        + '[[participants]]\nname = "dora"\n[[participants]]\nname = "erin"\n[[participants]]\nname = "fay"\n'
        + '[disputes]\njudges = ["dora", "erin", "fay"]\nvotes = 3\njudge_stake_iec = 19\n',
        18,
        "disputes.judge_stake_iec: a stake of 19 IEC covers 190 IEC of accepted work, and one "
        "battery_charging costs 200 IEC: no vote for it would count",
    ),
    (item(x_m=6.98), 7, "items.0.pose: item1 reaches into a wall"),
    (item() + item("item2", x_m=4.63), 12, "items.1.pose: item2 overlaps item1"),
    (
        "[[bins]]\npose = { x_m = 5.2, y_m = 0.4, yaw_rad = -1.5708 }\n",
        4,
        "bins.0.pose: panther1 finds no way to the bin itrash from where it starts",
    ),
    (
        "[[docks]]\npose = { x_m = 6.9, y_m = 2.6, yaw_rad = 0.0 }\n",
        4,
        "docks.0.pose: panther1 finds no way to the dock dock1 from where it starts",
    ),
]


@pytest.mark.parametrize(("text", "line", "sentence"), DOUBTFUL)
def test_what_is_doubtful_is_a_warning_and_no_reason_to_refuse(
    said: Said, tmp_path: Path, text: str, line: int, sentence: str
) -> None:
    assert f"my.toml:{line}: warning: {sentence}" in said(text)
    Site.load(tmp_path / "my.toml")


MODBUS = """[[docks]]
pose = {{ x_m = 0.2, y_m = 2.6 }}
meter = {{ source = "modbus", address = "tcp://127.0.0.1:502", model = "{model}" }}
"""
SMALL = """[[robots]]
name = "arthur"
pose = { x_m = 1.4, y_m = 1.3 }
battery = { capacity_wh = 30, capacity_ah = 0.82 }
"""


def test_things_without_markers_are_doubtful_where_nothing_is_simulated(said: Said, tmp_path: Path) -> None:
    thing = item("thing1", x_m=3.0).replace("items", "things")
    assert not any("things" in one for one in said(thing))
    (tmp_path / "real.toml").write_text(f'extends = "{REAL}"\n{thing}')
    (found,) = check(tmp_path / "real.toml")
    assert (found.line, found.severity, found.place) == (2, "warning", ("things",))
    assert "nobody knows of them" in found.text


def test_a_meter_whose_steps_hide_what_a_robot_orders_is_doubtful(said: Said) -> None:
    assert said(MODBUS.format(model="sdm120")) == []
    (found,) = said(MODBUS.format(model="sdm120") + SMALL)
    assert "my.toml:5: warning: docks.0.meter: arthur orders 42.1 Wh at most" in found
    assert "confirms no order below 190 Wh" in found


def test_a_map_of_registers_that_cannot_be_read_is_an_error(said: Said) -> None:
    (found,) = said(MODBUS.format(model="sdm121"))
    assert "my.toml:5: error: docks.0.meter.model: no registers of a meter can be read" in found


@pytest.mark.parametrize(
    "clock",
    [
        'clock.holders = ["robot_agent", "itrash", "charger", "bridge"]',
        "clock.idle_speed = 1\nclock.speed = 1",
    ],
)
def test_executors_for_whom_the_clock_waits_are_no_doubt(said: Said, clock: str) -> None:
    jumps = "" if "idle_speed" in clock else "clock.idle_speed = 0\n"
    assert said(f'{jumps}{clock}\n[[participants]]\nname = "alice"\n') == []


OPEN = 'bus.open = true\nbus.router = "tcp/127.0.0.1:7447"\n'


def test_an_open_bus_is_warned_of_where_the_oracle_judges(said: Said) -> None:
    (found,) = said(OPEN)
    assert found.startswith(
        "my.toml:3: warning: bus.open: waste_disposal and battery_charging: the bus is open"
    )
    assert "nobody is paid" in found and "leave bus.router out" in found


def test_a_kind_that_nobody_judges_is_an_error_with_its_line(said: Said) -> None:
    (found,) = said('[[kinds]]\nname = "battery_charging"\n[[kinds]]\nname = "waste_disposl"\n')
    assert found.startswith("my.toml:6: error: kinds.1.name: no installed package brings this kind")
    assert 'judge = "auditor"' in found and found.endswith('is "waste_disposal" meant?')


ITEM = (
    'items = [{{ id = "a", class = "metal", shape = "can", pose = {{ x_m = 4.6, y_m = 1.2 }}, '
    "mass_kg = {} }}]\n"
)
ROBOT = 'robots = [{{ name = "{}", pose = {{ x{} = 1.4, y_m = 1.3 }} }}]\n'
MEANT = [
    ("lab.size_m = [700, 500]\n", "warning: lab.size_m: a room of 700 m by 500 m: 700 cm are 7 m"),
    ("lab.mass_tolerance = 50\n", "50 is a share, 1 is all of an item's mass: 50 % are 0.5"),
    (BINS.format("itrash", 0).replace("-1.5708", "90"), "90 degrees are 1.5708 rad"),
    (ITEM.format(30), "write at most 0.2 kg, not 30; 30 g are 0.03"),
    (ITEM.format('"30 g"'), 'write a number in kg, not "30 g": 0.03'),
    (ITEM.format("[0.03]"), "write a number in kg, not [0.03]"),
    ('economy.electricity = [{ from_hour = 6, eur_kwh = "0,34" }]\n', 'not "0,34": 0.34'),
    ("console.port = 80888\n", "console.port: write at most 65535, not 80888"),
    ('clock.source = "real"\n', 'clock.source: write one of "sim", "wall", not "real"'),
    (ROBOT.format("panther1", ""), 'pose.x: no such key; is "x_m" meant?'),
    (ROBOT.format("Panther 1", "_m"), "write small letters, digits, _"),
    ('[demo]\nkind = "waste_disposal"\nparams = { item_id = "item9" }\n', "choose one of this site: item1"),
    ('demo.kind = "waste_disposl"\n', 'does not list waste_disposl; is "waste_disposal" meant?'),
]


@pytest.mark.parametrize(("text", "words"), MEANT)
def test_a_mistake_is_answered_with_what_to_write(said: Said, text: str, words: str) -> None:
    assert any(words in found for found in said(text)), said(text)


def test_nobody_reads_the_words_of_the_library_that_checks_the_file(said: Said) -> None:
    for text, _ in MEANT:
        assert not any("Input should" in found or "validation" in found for found in said(text))


def test_what_stands_in_the_file_that_is_extended_is_found_there(said: Said) -> None:
    line = next(n for n, text in enumerate(LAB.read_text().splitlines(), 1) if "shelf1" in text)
    assert said("lab.size_m = [5.0, 5.0]\n")[0].startswith(
        f"{LAB}:{line}: error: lab.furniture.2.pose: shelf1 is outside the room"
    )


def test_what_is_no_toml_is_said_with_its_line(said: Said) -> None:
    (found,) = said("chain.url = \n")
    assert found.startswith("my.toml:3: error: cannot read the site file")


@pytest.mark.parametrize("name", ["robots", "rooms", "bins"])
def test_what_is_no_list_is_an_error_with_its_line(said: Said, name: str) -> None:
    assert said(f"{name} = 5\n") == [f"my.toml:3: error: {name}: write a list in [ ], not 5"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("extends = 5\n", "extends: name one file"),
        ('extends = "a\\u0000b"\n', "extends: this names no file or folder: embedded null byte"),
        ('data_dir = "~nobody-of-this-name/x"\n', "data_dir: this names no file or folder: "),
        ('data_dir = "a\\u0000b"\n', "data_dir: this names no file or folder: embedded null byte"),
    ],
)
def test_what_is_no_path_is_an_error(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "my.toml"
    path.write_text(text)
    (found,) = check(path)
    assert str(found).startswith(f"{path}: error: {says}")


def test_of_files_that_extend_each_other_the_one_at_fault_is_named(tmp_path: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text('extends = "other.toml"\n')
    (found,) = check(path)
    assert (
        str(found)
        == f"{tmp_path / 'other.toml'}: error: cannot read the site file: No such file or directory"
    )


def test_the_names_of_shapes_are_those_of_their_geometry() -> None:
    assert {kind: tuple(shapes) for kind, shapes in SHAPES.items()} == SHAPE_NAMES


def test_lines_are_told_through_strings_comments_and_nested_lists() -> None:
    text = '''# [no]
a = "x # [y] = 1"  # z = 2
b = [
  { c = 1 }, # first
  { "d e" = [1, 2] },
]
[t.u]
f.g = """
[not]
"""
[[v]]
[[v]]
h = 1.5
[v.w]
i = 2
'''
    assert {place: line for place, line in lines_of(text).items() if place not in [("b",), ("v",)]} == {
        ("a",): 2,
        ("b", 0): 4,
        ("b", 0, "c"): 4,
        ("b", 1): 5,
        ("b", 1, "d e"): 5,
        ("b", 1, "d e", 0): 5,
        ("b", 1, "d e", 1): 5,
        ("t", "u"): 7,
        ("t", "u", "f"): 8,
        ("t", "u", "f", "g"): 8,
        ("v", 0): 11,
        ("v", 1): 12,
        ("v", 1, "h"): 13,
        ("v", 1, "w"): 14,
        ("v", 1, "w", "i"): 15,
    }


NAMES = ("a-b", "set-entity-state", "alice", "a--b")
PEOPLE = "".join(f'[[participants]]\nname = "{name}"\n' for name in NAMES)


@pytest.mark.parametrize(
    ("head", "listed", "sentence"),
    [
        ("", '["nobody"]', "nobody on this site is called nobody"),
        ("", '["organization"]', "the organization's own wallet takes no commands over ROS 2"),
        ("", '["alice", "alice"]', "alice is listed twice"),
        ("", '["a--b"]', "ROS 2 takes no name with two underscores in a row, and a--b is a__b there"),
        ("", '["set-entity-state"]', "the lab itself has a service of this name in ROS 2"),
        ('org = "panther1"\n', '["alice"]', "panther1 in ROS 2, like the namespace of a robot: rename one"),
        ('org = "mocap"\n', '["alice"]', "a name that the lab itself uses there: rename one"),
        ('org = "tf"\n', '["alice"]', "a name that the lab itself uses there: rename one"),
        ('org = "rosout"\n', '["alice"]', "a name that the lab itself uses there: rename one"),
        ('org = "clock"\n', '["alice"]', "a name that the lab itself uses there: rename one"),
        ('org = "itrash"\n', '["alice"]', "a name that the lab itself uses there: rename one"),
        ('org = "x--y"\n', '["alice"]', "ROS 2 takes no name with two underscores in a row"),
    ],
)
def test_a_name_that_cannot_be_in_ros_is_an_error(said: Said, head: str, listed: str, sentence: str) -> None:
    found = said(f'{head}{PEOPLE}[[ros]]\nowner = "annas"\nparticipants = {listed}\n')
    assert len(found) == 1 and sentence in found[0]


def test_two_names_that_are_the_same_in_ros_are_an_error(said: Said) -> None:
    robots = '[[robots]]\nname = "a_b"\npose = { x_m = 1.4, y_m = 1.3 }\n'
    tables = [
        f'[[ros]]\nowner = "{one}"\nparticipants = ["{name}"]\n' for one, name in (("x", "a-b"), ("y", "a_b"))
    ]
    found = said(PEOPLE + robots + "".join(tables))
    assert len(found) == 1 and "a_b and a-b are both a_b in ROS 2" in found[0]
    assert said(PEOPLE + robots) == []


def test_a_mind_has_the_same_name_in_ros_as_nobody_else(said: Said) -> None:
    """It would have the parameters of the other one's nodes."""
    head = "clock.speed = 1\nclock.idle_speed = 1\n"
    robots = [
        f'[[robots]]\nname = "{name}"\npose = {{ x_m = {x_m}, y_m = 1.3 }}\nmind = "node.{mind}"\n'
        for name, x_m, mind in (("a_b", 1.4, "a_b"), ("other", 3.4, "a-b"))
    ]
    found = said(head + PEOPLE + "".join(robots))
    assert [one for one in found if "a-b and a_b are both a_b in ROS 2" in one]
    found = said(f'{head}org = "x--y"\n{PEOPLE}{robots[0]}')
    assert [one for one in found if "ROS 2 takes no name with two underscores in a row" in one]


@pytest.mark.parametrize("namespace", ["tf", "rosout", "clock", "mocap/other", "parameter_events"])
def test_no_robot_speaks_below_a_name_of_the_lab_itself(said: Said, namespace: str) -> None:
    found = said(robot(f'name = "other"\nnamespace = "{namespace}"'))
    assert len(found) == 1 and f"the lab itself uses the name {namespace} in ROS 2" in found[0]
    assert said(robot(f'name = "other"\nnamespace = "fleet/{namespace}"')) == []


def test_one_owner_has_one_process(said: Said) -> None:
    table = '[[ros]]\nowner = "x"\nparticipants = ["{}"]\n'
    found = said(PEOPLE + table.format("alice") + table.format("a-b"))
    assert len(found) == 1 and 'two processes speak ROS 2 for "x"' in found[0]


MINDED = '[[robots]]\nname = "panther1"\npose = {{ x_m = 1.4, y_m = 1.3 }}\nmind = "{}"\n'
SPOKEN = '[[ros]]\nowner = "mine"\nparticipants = ["panther1"]\n'


@pytest.mark.parametrize(
    ("head", "mind", "sentence"),
    [
        (
            "",
            "node.panter1",
            'of this site is called panter1; is "panther1" meant?',
        ),
        ("", "node.organization", "no robot and no participant of this site is called organization"),
        ("", "panther1", "mind"),
        ("clock.speed = 0\n", "node.panther1", "clock.speed = 0 waits for no ROS 2 node"),
        ("clock.speed = 20\n", "node.panther1", "the clock waits for no node.panther1: set clock.speed"),
    ],
)
def test_a_mind_that_cannot_be_one_is_named(said: Said, head: str, mind: str, sentence: str) -> None:
    found = said(head + MINDED.format(mind) + SPOKEN)
    assert len(found) == 1 and sentence in found[0]


def test_a_mind_without_a_process_that_gives_its_commands_is_doubtful(said: Said) -> None:
    head = "clock.speed = 1\nclock.idle_speed = 1\n"
    found = said(head + MINDED.format("node.panther1"))
    assert len(found) == 1 and "no [[ros]] lists panther1" in found[0]
    assert said(head + MINDED.format("node.panther1") + SPOKEN) == []


MISTAKES = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text())


def test_there_are_ten_mistakes_of_each_sort_in_a_file_that_is_right_without(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(MISTAKES["site"])
    assert [one for one in check(path) if one.severity == "error"] == []
    sorts = Counter(one["sort"] for one in MISTAKES["mistake"])
    assert sorts == dict.fromkeys(("unit", "name", "contradiction", "missing"), 10)


@pytest.mark.parametrize("one", MISTAKES["mistake"], ids=lambda one: one["what"])
def test_a_planted_mistake_is_found_with_its_line_and_what_to_write(
    one: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "site.toml"
    assert MISTAKES["site"].count(one["old"]) == 1
    text = MISTAKES["site"].replace(one["old"], one["new"])
    path.write_text(text)
    lines = text.splitlines()
    found = [
        finding
        for finding in check(path)
        if not one["at"] or (finding.line and lines[finding.line - 1].startswith(one["at"]))
    ]
    assert any(all(word in str(finding) for word in one["says"]) for finding in found), found
