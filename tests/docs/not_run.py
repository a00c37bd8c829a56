"""Commands of the documentation that no test runs as they stand, and why; options and files are checked."""

from __future__ import annotations

_SUITE = "runs the suite itself, or a part of it"
_INSTALLS = "installs packages"
_MINUTES = "takes more than a minute"
_ROS = "needs a robot that runs ROS 2"
_NODES = "needs ROS 2: tests/integration/test_ros_minds.py runs the node on a stand-in"
_ROS1 = "needs a robot that runs ROS 1"
_SHELL = "sets the reader's shell up"
_FOREIGN = "tests/integration/test_foreign_bin.py starts the page's bin and the others beside it"
_JUDGES = "needs a site with several oracles: tests/integration/test_quorum.py runs such commands"
_DISPUTES = "needs a ruling that stands: tests/integration/test_disputes.py runs such commands"
_MEMBERS = "needs an organization whose members vote: tests/integration/test_governance.py runs such commands"
_SYSTEMD = "needs a computer that systemd starts: tests/unit/deploy/test_units.py checks the units"
_CHAIN = "needs an Ethereum node of one's own: tests/integration/test_another_chain.py starts one and runs it"

_PLACE = (
    "posts a task that the pages after it do not count: tests/integration/test_agent.py has such tasks done"
)
_POOL = "needs several machines: tests/integration/test_pool.py starts a pool"

NOT_RUN: dict[str, str] = {
    "rodeo task dispute show 7": _DISPUTES,
    'rodeo task dispute challenge 7 --as panther1 --reason "the can is in the bin"': _DISPUTES,
    "rodeo task dispute vote 7 accepted --as dora --votes votes.json": _DISPUTES,
    "rodeo task create waste_disposal --at 3.2,1.4 --reward 100": _PLACE,
    "rodeo task create waste_disposal --at 3.2,1.4 --photo photo.jpg --reward 100": _PLACE,
    "git clone --depth 1 URL rodeo && cd rodeo": "downloads the project",
    "make demo": f"{_MINUTES}: tests/integration/test_demo.py runs what it runs",
    "rodeo experiment paper": f"{_MINUTES}: tests/integration/test_experiment.py runs a short one",
    "rodeo experiment paper --unlisted": f"{_MINUTES}: tests/integration/test_experiment.py runs a short one",
    "rodeo seen say 3 dismissed": "needs what a robot has seen: tests/integration/test_console_office.py",
    "rodeo experiment ablation": f"{_MINUTES}: tests/unit/rodeo_experiments tests it",
    "python -m rodeo_cli.lab_picture --site deploy/sites/lab.toml --out docs/images/lab.png": "overwrites it",
    "python -m rodeo_cli.lab_picture --site out/demo/site.toml --recording "
    "out/demo/data/robot_agent/tasks/1-1/recording.mcap --out docs/images/cleaning.webp": (
        f"{_MINUTES}: tests/unit/cli/test_film.py makes a small one"
    ),
    "python -m tests.docs.pictures": f"{_MINUTES}, and overwrites them",
    "make setup": _INSTALLS,
    "make system": _INSTALLS,
    "apt-get install git make python3 python3-venv": _INSTALLS,
    "make lint": _SUITE,
    "make test": _SUITE,
    "make test-long": _SUITE,
    "make symbolic": _SUITE,
    "npm run contracts:test -- --match-contract TermsTest": _SUITE,
    "make bench ONLY=contracts": _MINUTES,
    "RODEO_CONTRACTS=sources npm run contracts:test -- --match-contract TermsTest": _SUITE,
    "make test-contracts": _SUITE,
    "npm run contracts:coverage": _SUITE,
    "npm run contracts:mutants": _SUITE,
    "npm run contracts:slither": "needs slither, which the project does not install",
    "source .venv/bin/activate": _SHELL,
    "rodeo down": "ends the reader's site, which the commands below need",
    "rodeo site remove": "asks: tests/unit/cli/test_init.py removes sites",
    "rodeo up --detach --site my-site/site.toml": f"{_MINUTES}, and starts a second site",
    "rodeo up": "stays in the foreground until Ctrl-C; the line below starts the same site",
    "rodeo up --new-chain": "is for a site whose chain is lost",
    "rodeo up --new-journal": "is for a site whose journal is lost",
    "rodeo up --only oracle": "is for a site whose oracle does not run yet",
    'pip install --constraint constraints.txt -r training/requirements.txt -e ".[dev]"': "installs gigabytes",
    "pip wheel --no-deps .": "tests/integration/test_wheel.py builds the wheel",
    'pip install "$(ls rodeo_dao-*.whl)[site]"': "tests/integration/test_wheel.py installs it",
    "rodeo demo": f"{_MINUTES}: tests/integration/test_wheel.py runs it",
    "python -m training.train --data ../shared/data/trashnet --out ~/itrash-model": (
        f"{_MINUTES}, and needs training/requirements.txt"
    ),
    "python -m training.others": "downloads packages: tests/unit/training/test_others.py",
    "python -m training.train --data ../shared/data/trashnet --all --out ~/itrash-model": (
        "needs trained networks: tests/unit/training/test_cross_validate.py"
    ),
    "python -m training.cross_validate --data ../shared/data/trashnet": (
        "takes hours, and needs training/requirements.txt: tests/unit/training/test_cross_validate.py"
    ),
    "python -m training.answers --data ../shared/data/trashnet": (
        "needs trained networks: tests/unit/training/test_answers.py"
    ),
    "python -m training --add-corrections site.toml": (
        "needs trained networks: tests/unit/training/test_corrected.py"
    ),
    "export RODEO_KEYSTORE_PASSPHRASE=...": _SHELL,
    "rodeo up --site my-site.toml": _CHAIN,
    "rodeo site prepare --site my-site.toml": _CHAIN,
    "rodeo up router chain bridge oracle charger console robot_sim robot_agent": _FOREIGN,
    "python examples/my_bin.py --site deploy/sites/lab.toml": _FOREIGN,
    "rodeo organization sign-seat dora-device --owner panther1": _JUDGES,
    "rodeo organization seat 0x... --owner panther1 --signature 0x...": _JUDGES,
    "rodeo organization unseat carl": _JUDGES,
    "rodeo organization quorum waste_disposal 2 --judge anna --judge bert --judge dora": _JUDGES,
    "rodeo organization budget-votes --as alice": _MEMBERS,
    "rodeo organization vote-budget 0 alice=6 bob=8 --as alice": _MEMBERS,
    "rodeo organization pay-budget 0": _MEMBERS,
    "ros2 topic hz /fleet/arthur/joint_states": _ROS,
}
"""Command -> reason."""

_NEW_KIND = "tests/docs/test_write_a_kind.py runs it in an environment of its own"

ON_THEIR_OWN = (
    "rodeo kind new inspect_door --into inspect-door",
    "pip install --no-deps --editable ./inspect-door",
    "rodeo kind list",
    "rodeo kind check inspect_door",
    "rodeo kind show inspect_door",
    "rodeo kind check inspect_door --only looks_away",
    "rodeo kind check inspect_door",
    "python -m pytest inspect-door/tests",
)
"""The commands of docs/tutorials/kind.md, in order."""
NOT_RUN |= dict.fromkeys(ON_THEIR_OWN, _NEW_KIND)

BEGINNINGS = {
    "export ": _SHELL,
    "ros2 ": _ROS,
    **dict.fromkeys(("roslaunch ", "rosservice ", "rostopic ", "cp -r rodeo", "cd ~/catkin_ws"), _ROS1),
    **dict.fromkeys(("sudo apt-get install ros-", "pip3 install eclipse-zenoh"), _ROS1),
    "rodeo experiment paper --seeds": "takes hours: tests/unit/rodeo_experiments/test_study.py runs studies",
    **dict.fromkeys(("rodeo pool ", "sbatch ", "kubectl ", "scp ", "ssh "), _POOL),
    "python -m pytest ": _SUITE,
    "python examples/ros2/": _NODES,
    **dict.fromkeys(
        ("systemctl ", "journalctl ", "adduser ", "/opt/rodeo/", "install ", "sudo -u rodeo "), _SYSTEMD
    ),
    "python3 -m venv /opt/rodeo": _INSTALLS,
    "docker ": "needs Docker: tests/unit/deploy/test_containers.py checks the files",
}
"""The same for all commands that begin so."""


def reason(command: str) -> str | None:
    """Why this command is not run; None where it is."""
    if command in NOT_RUN:
        return NOT_RUN[command]
    if " --pool " in command:
        return _POOL
    return next((why for start, why in BEGINNINGS.items() if command.startswith(start)), None)
