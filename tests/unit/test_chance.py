"""Chance: everything random on a site follows its seed, and nothing draws from anywhere else."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rodeo.errors import ConfigError
from rodeo.lab.body import Twist2
from rodeo.site.chance import Moments, generator
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from rodeo.site.sections import ClockConfig
from services.robot_sim.simulation import Simulation
from tests.support.site import LAB

ROOT = Path(__file__).parents[2]
START_NS = 1_800_000_000_000_000_000


def site(seed: int | None) -> Site:
    return Site.load(LAB).model_copy(update={"clock": ClockConfig(seed=seed)})


def draws(
    seed: int | None, process: str = "robot_agent", purpose: str = "explore", **how: bool
) -> list[float]:
    return list(generator(site(seed), process, purpose, **how).random(4))


def test_one_seed_draws_the_same_each_time() -> None:
    assert draws(7) == draws(7)


@pytest.mark.parametrize(
    "others",
    [
        pytest.param(draws(8), id="another seed"),
        pytest.param(draws(7, "robot_sim"), id="another process"),
        pytest.param(draws(7, purpose="greet"), id="another purpose"),
        pytest.param(draws(7, "robot_agent.explore", ""), id="the same words, parted elsewhere"),
    ],
)
def test_nobody_shares_draws(others: list[float]) -> None:
    assert not set(draws(7)) & set(others)


def test_the_derivation_is_as_documented_so_that_others_can_repeat_it() -> None:
    text = b'[7, "robot_agent.panther1", "explore"]'
    theirs = np.random.default_rng(int(hashlib.sha256(text).hexdigest(), 16))
    assert draws(7, "robot_agent.panther1") == list(theirs.random(4))


def test_without_a_seed_choices_differ_at_each_start_and_what_is_repeatable_is_not_lost() -> None:
    assert draws(None) != draws(None)
    assert draws(None, repeatable=True) == draws(None, repeatable=True) == draws(0)


def test_what_belongs_to_a_moment_is_the_same_whatever_was_drawn_before() -> None:
    busy, idle = (Moments(site(7), "robot_sim", "lidar of panther1") for _ in range(2))
    for time_ns in range(START_NS, START_NS + 5):
        busy.at(time_ns).standard_normal(100)
    assert list(busy.at(START_NS + 9).random(4)) == list(idle.at(START_NS + 9).random(4))
    assert not set(idle.at(START_NS).random(4)) & set(idle.at(START_NS + 1).random(4))
    other = Moments(site(8), "robot_sim", "lidar of panther1")
    assert not set(idle.at(START_NS).random(4)) & set(other.at(START_NS).random(4))


@pytest.mark.parametrize("seed", ["-1", "1.5", "many"])
def test_a_seed_is_a_whole_number_from_0(monkeypatch: pytest.MonkeyPatch, seed: str) -> None:
    monkeypatch.setenv("RODEO__CLOCK__SEED", seed)
    with pytest.raises(ConfigError) as refused:
        Site.load(LAB)
    assert list(refused.value.details["fields"]) == ["clock.seed"]


def test_the_seed_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Site.load(LAB).clock.seed is None
    monkeypatch.setenv("RODEO__CLOCK__SEED", "41")
    assert Site.load(LAB).clock.seed == 41


# -- the simulated lab -------------------------------------------------------------------------------------


@cache
def driven(seed: int | None, _run: int = 1) -> Simulation:
    simulation = Simulation(site(seed), START_NS)
    robot = simulation.robots["panther1"]
    for _ in range(60):
        robot.command(Twist2(0.4, 0.3), simulation.moved_s)
        simulation.step()
    return simulation


def sensed(simulation: Simulation) -> list[np.ndarray]:
    robot = simulation.robots["panther1"]
    return [
        np.array([robot.odometry.x_m, robot.odometry.y_m, robot.odometry.yaw_rad]),
        robot.scan_m(simulation.time_ns),
        robot.depth_m(simulation.time_ns),
    ]


def test_a_simulated_robots_sensors_err_as_the_seed_says() -> None:
    first, again, other = (sensed(driven(*run)) for run in ((7, 1), (7, 2), (8, 1)))
    for one, same, another in zip(first, again, other, strict=True):
        assert np.array_equal(one, same, equal_nan=True)
        assert not np.array_equal(one, another, equal_nan=True)


def test_without_a_seed_a_simulated_robot_is_the_same_after_each_start() -> None:
    for one, same in zip(sensed(driven(None, 1)), sensed(driven(None, 2)), strict=True):
        assert np.array_equal(one, same, equal_nan=True)


def test_a_picture_is_the_same_however_many_were_taken_before() -> None:
    quiet, busy = driven(7, 1), driven(7, 2)
    time_ns, robot = busy.time_ns, busy.robots["panther1"]
    for earlier_ns in range(time_ns - 3, time_ns):
        robot.depth_m(earlier_ns)
        robot.scan_m(earlier_ns)
    for one, same in zip(sensed(quiet), sensed(busy), strict=True):
        assert np.array_equal(one, same, equal_nan=True)


def test_two_robots_have_minds_and_sensors_of_their_own() -> None:
    lab = site(7)
    twin = lab.robots[0].model_copy(update={"name": "panther2"})
    both = lab.model_copy(update={"robots": [lab.robots[0], twin]})
    one, two = (generator(both, robot_process(both, robot.name), "explore").random() for robot in both.robots)
    assert one != two


# -- nobody draws elsewhere --------------------------------------------------------------------------------

ELSEWHERE = {
    "rodeo/evidence/upload.py": "names of files that are being written",
    "rodeo/site/chance.py": "this is where",
    "rodeo/lab/items.py": "the geometry of a shape, which bin, simulator and oracle share",
    "rodeo/ros2/action.py": "goal ids are unique, and decide nothing",
    "rodeo/signing/wallets.py": "a passphrase",
    "rodeo/commands/governance.py": "salts by which equal proposals are told apart",
    "rodeo/commands/relaying.py": "nonces of signed requests, which only have to be new",
    "rodeo_cli/auditing/bounds.py": "a sample, chosen by the hash of the newest block",
    "rodeo_cli/accounts.py": "the passphrase of the demo's account, which nobody learns",
    "rodeo/access/accounts.py": "tokens, and the hash of nobody's passphrase",
    "services/console/guard.py": "the nonce of a page",
    "services/console/pages/tasks.py": "ids of requests",
    "rodeo/checks/motion/replay.py": "a verdict is the same on every site",
    "rodeo_experiments/ablation.py": "draws forgeries by a seed that it is given; does not run on a site",
    "deploy/contracts.py": "salts by which a timelock tells its acts apart; they decide nothing",
    "deploy/chain/local_chain.py": "the identity of a local chain and of its blocks",
}
"""Files that draw from a source of their own, and why they may."""
SOURCES = ("random", "secrets", "uuid")


def sources(path: Path) -> Iterator[str]:
    """Names of the sources of chance that the file at `path` opens."""
    text = path.read_text()
    if not any(word in text for word in (*SOURCES, "urandom")):
        return  # most files; reading their syntax takes long
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name in SOURCES)
        elif isinstance(node, ast.ImportFrom) and node.module in (*SOURCES, "numpy.random"):
            yield node.module
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called == "os.urandom" or (".random." in called and not called.startswith("self.")):
                yield called


def test_nobody_in_the_deployed_code_draws_from_a_source_that_the_site_does_not_seed() -> None:
    files = [
        path
        for folder in ("rodeo", "rodeo_cli", "rodeo_experiments", "rodeo_kinds", "services", "deploy")
        for path in (ROOT / folder).rglob("*.py")
        if "harness" not in path.parts  # makes recordings for tests
    ]
    found = {str(path.relative_to(ROOT)) for path in files if any(sources(path))}
    assert found == set(ELSEWHERE)
