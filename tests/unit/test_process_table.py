"""The process table: one mind per robot, and no chain where it is elsewhere."""

from __future__ import annotations

from rodeo.lab.config import Pose2, RobotConfig
from rodeo.site.config import Site
from rodeo.site.faults import faults
from rodeo.site.processes import hosts_of, processes_of
from rodeo.site.sections import ChainConfig, OtherBridgeConfig, RosConfig
from tests.support.site import LAB

SITE = Site.load(LAB)


def on_hosts(router: str = "tls/10.0.0.1:7447", **hosts: list[str]) -> Site:
    bus = SITE.bus.model_copy(update={"router": router})
    return SITE.model_copy(update={"hosts": hosts, "bus": bus})


ALL = [process.name for process in processes_of(SITE)]


def test_each_computer_has_its_processes_in_the_tables_order() -> None:
    assert hosts_of(SITE) == {"": processes_of(SITE)}
    site = on_hosts(dock=["charger"], office=[name for name in reversed(ALL) if name != "charger"])
    assert not faults(site)
    found = {host: [one.name for one in entries] for host, entries in hosts_of(site).items()}
    assert found == {"dock": ["charger"], "office": [name for name in ALL if name != "charger"]}


def test_each_process_is_on_one_computer() -> None:
    site = on_hosts(dock=["chargr", "oracle"], office=[name for name in ALL if name != "charger"])
    oracle = site.hosts["office"].index("oracle")
    assert faults(site) == {
        ("hosts", "dock", 0): 'this site has no process chargr; is "charger" meant?',
        ("hosts", "office", oracle): "oracle is on dock already",
        ("hosts",): "on no computer: charger",
    }


def test_two_computers_have_no_socket_between_them() -> None:
    hosts = {"dock": ["charger"], "office": [name for name in ALL if name != "charger"]}
    assert ("hosts",) in faults(on_hosts(SITE.bus.router, **hosts))
    assert not faults(on_hosts(SITE.bus.router, office=ALL))


def test_a_site_of_one_robot_has_one_plain_agent() -> None:
    (agent,) = [p for p in processes_of(SITE) if p.name.startswith("robot_agent")]
    assert (agent.name, agent.arguments) == ("robot_agent", ())


def test_each_of_several_robots_has_a_mind_of_its_own() -> None:
    robots = [RobotConfig(name=name, pose=Pose2(x_m=1, y_m=1)) for name in ("panther1", "panther2")]
    processes = processes_of(SITE.model_copy(update={"robots": robots}))
    agents = {p.name: p.arguments for p in processes if p.module == "services.robot_agent"}
    assert agents == {
        "robot_agent.panther1": ("--robot", "panther1"),
        "robot_agent.panther2": ("--robot", "panther2"),
    }
    assert len({p.name for p in processes}) == len(processes)


PLURAL = Site.load(LAB.with_name("plural.toml"))


def test_each_of_several_bins_and_docks_has_a_process_of_its_own() -> None:
    known = {p.name: p.arguments for p in processes_of(PLURAL)}
    assert {name: known[name] for name in known if "." in name} == {
        "itrash.bin_north": ("--bin", "bin_north"),
        "itrash.bin_east": ("--bin", "bin_east"),
        "charger.dock_west": ("--dock", "dock_west"),
        "charger.dock_east": ("--dock", "dock_east"),
    }
    assert not known.keys() & {"itrash", "charger"}
    none = PLURAL.model_copy(update={"bins": [], "docks": []})
    assert not [p for p in processes_of(none) if p.module in ("services.itrash", "services.charger")]


def test_each_further_bridge_is_a_process_of_its_own() -> None:
    site = SITE.model_copy(update={"bridges": [OtherBridgeConfig(name="judges")]})
    bridges = {p.name: p.arguments for p in processes_of(site) if p.module == "services.bridge"}
    assert bridges == {"bridge": (), "bridge.judges": ("--bridge", "judges")}


def test_a_chain_elsewhere_is_not_started() -> None:
    site = SITE.model_copy(update={"chain": ChainConfig(backend="external")})
    assert "chain" not in {p.name for p in processes_of(site)}


def test_a_robot_whose_mind_is_a_ros_node_has_a_recorder_in_place_of_an_agent() -> None:
    minds = {"panther1": None, "panther2": "node.panther2"}
    robots = [RobotConfig(name=name, pose=Pose2(x_m=1, y_m=1), mind=mind) for name, mind in minds.items()]

    def of(*robots: RobotConfig) -> dict[str, tuple[str, ...]]:
        processes = processes_of(SITE.model_copy(update={"robots": list(robots)}))
        modules = ("services.robot_agent", "services.robot_recorder")
        return {p.name: p.arguments for p in processes if p.module in modules}

    assert of(*robots) == {
        "robot_agent.panther1": ("--robot", "panther1"),
        "robot_recorder.panther2": ("--robot", "panther2"),
    }
    assert of(robots[1]) == {"robot_recorder": ()}


def test_each_owner_of_ros_nodes_has_a_process_and_nobody_else_pays_for_one() -> None:
    def of(*owners: str) -> dict[str, tuple[str, ...]]:
        tables = [RosConfig(owner=one, participants=[one]) for one in owners]
        processes = processes_of(SITE.model_copy(update={"ros": tables}))
        return {p.name: p.arguments for p in processes if p.module == "services.ros_dao"}

    assert of() == {}
    assert of("annas") == {"ros_dao": ()}
    assert of("annas", "berts") == {
        "ros_dao.annas": ("--owner", "annas"),
        "ros_dao.berts": ("--owner", "berts"),
    }
