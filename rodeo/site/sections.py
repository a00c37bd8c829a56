"""The tables of a site file, one model for each."""

from __future__ import annotations

import re
import time
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from rodeo.errors import unreadable
from rodeo.lab.config import RobotConfig
from rodeo.money.currency import IEC, MAX_DECIMALS, MIN_DECIMALS, Currency
from rodeo.money.rewards import Rise
from rodeo.site import endpoint
from rodeo.site.topics import BODY, FOLLOW_JOINT_TRAJECTORY, Form, Plane, Topic
from rodeo.text import redaction
from rodeo.text.addresses import typed_address

MiB = 1 << 20


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


_SECRET = "{secret}"
"""What stands for the provider's key in the node's addresses."""


def _url(*schemes: str, empty: bool = False) -> AfterValidator:
    """An address of one of these schemes, with a host; with `empty` perhaps none."""

    def checked(text: str) -> str:
        if _SECRET not in text:
            redaction.learn(text, path_is_secret=True)
        if empty and not text:
            return text
        parts = urlsplit(text)
        if parts.scheme not in schemes or not parts.hostname:
            raise ValueError(f"this is no URL such as {schemes[0]}://127.0.0.1:8545")
        if parts.port == 0:
            raise ValueError("port 0 is no port to connect to")
        return text

    return AfterValidator(checked)


def _with_password(text: str) -> str:
    """An address whose password no output shows."""
    redaction.learn(text)
    return text


class BusConfig(_Table):
    router: str = endpoint.LOCAL
    """Zenoh endpoint of the router. "local", the default, is a Unix socket in a folder that only the site's
    user can open; a loaded `Site` has its endpoint here. "tls/..." asks for certificates."""
    open: bool = False
    """Allow an endpoint such as "tcp/...", where everybody who can connect can publish as any process. Status
    and console then show a warning. A witness that reads its sensors over such a bus is not enough alone."""
    domain_id: int = Field(default=0, ge=0, le=232)
    """ROS_DOMAIN_ID of the robot plane."""

    @model_validator(mode="after")
    def _is_closed_or_says_so(self) -> Self:
        if problem := endpoint.problem(self.router, self.open):
            raise ValueError(problem)
        return self


ROS_TIME_ENDS_S = 2**31
"""Unix time after which builtin_interfaces/Time, which has 32 bits of seconds, has no times any more."""


class ClockConfig(_Table):
    source: Literal["sim", "wall"] = "sim"
    """With `wall` the site runs on the machine's own clock, and both speeds are 1, whatever the file says.
    What is simulated all the same has to say so: `source = "sim"`."""
    speed: float = Field(default=1.0, ge=0)
    """Simulated seconds per wall second; 0 runs as fast as the machine allows."""
    idle_speed: float = Field(default=1.0, ge=0)
    """Simulated seconds per wall second while a robot charges and nothing moves. With 0 the clock also skips
    all time in which robots rest and nobody has anything to do."""
    holders: list[Literal["robot_agent", "itrash", "charger", "bridge", "oracle", "chain", "arrivals"]] = [
        "robot_agent",
        "itrash",
        "charger",
    ]
    """Processes that a simulated clock waits for while they are busy (`rodeo.bus.holding`); a robot's
    recorder holds it as `robot_agent` does. With `bridge`, `oracle` and `chain` in the list, the speed of the
    machine does not change what a site does. `arrivals` is the process that posts the tasks of an
    experiment."""
    start: AwareDatetime | None = None
    """Time at which a simulated site begins, with a UTC offset: 2026-05-04T06:00:00Z. None: the wall time."""
    seed: int | None = Field(default=None, ge=0)
    """Seed of every random choice on the site, real or simulated (rodeo.site.chance). None: a robot's mind
    chooses differently at each start, and the simulated sensors have the noise of seed 0."""

    @field_validator("start")
    @classmethod
    def _starts_in_ros_time(cls, start: datetime | None) -> datetime | None:
        if start is not None and not 0 <= start.timestamp() < ROS_TIME_ENDS_S:
            end = datetime.fromtimestamp(ROS_TIME_ENDS_S, UTC)
            raise ValueError(f"times in ROS messages lie between 1970 and {end:%Y-%m-%d}, not {start}")
        return start

    @model_validator(mode="after")
    def _the_wall_goes_at_its_own_speed(self) -> Self:
        if self.source == "wall":
            self.speed = self.idle_speed = 1.0
        return self

    @model_validator(mode="after")
    def _starts_only_what_goes_its_own_way(self) -> Self:
        if self.start is not None and self.keeps_wall_time:
            raise ValueError(
                "clock.start needs a simulated clock that does not run on wall time: set clock.speed"
            )
        return self

    def begin_s(self) -> int:
        """Unix time at which a new world, and the chain of its site, begins."""
        return int(time.time() if self.start is None else self.start.timestamp())

    @property
    def keeps_wall_time(self) -> bool:
        """Whether the site runs on wall time: with a real clock, or simulated at speed 1 throughout."""
        return self.source == "wall" or (self.speed, self.idle_speed) == (1, 1)


LOCAL_CHAIN_ID = 31_337
"""Chain id of local chains, the one that anvil and Hardhat use."""


class ChainConfig(_Table):
    backend: Literal["eth-tester", "anvil", "external"] = "eth-tester"
    """Which local chain `deploy.chain` starts; external starts none and uses `url` as it is."""
    id: int = Field(default=LOCAL_CHAIN_ID, gt=0)
    """Chain ID (EIP-155). Processes refuse a node that answers with another ID, and deploy nothing there."""
    url: Annotated[str, _url("http", "https")] = "http://127.0.0.1:8545"
    """The node. No output shows more of it than scheme, host and port."""
    websocket_url: Annotated[str, _url("ws", "wss", empty=True)] | None = None
    """WebSocket URL for new blocks (eth_subscribe). None tries the address of `url`. With an empty string, or
    if the node has no subscriptions, the bridge polls the node."""
    secret_file: Path | None = None
    """File that contains the provider's key alone. The key replaces `{secret}` in `url` and `websocket_url`:
    `url = "https://node.example/v3/{secret}"`."""
    confirmations: int = Field(default=0, ge=0)
    """Blocks on top of an event's block before it is published."""
    max_block_age_s: float | None = Field(default=None, gt=0)
    """Age of the newest indexed block, s, above which the bridge is not ready, for chains that mine on wall
    time. None for chains that mine a block only for a transaction."""
    registry: Annotated[str, AfterValidator(typed_address)] | None = None
    """Where organizations are founded on a chain without the deterministic deployment proxy: `rodeo site
    prepare` says it when it puts a registry there. Elsewhere its address follows from its code."""

    @model_validator(mode="after")
    def _has_its_secret(self) -> Self:
        if self.secret_file is not None:
            try:
                secret = self.secret_file.read_text().strip()
            except (OSError, UnicodeDecodeError) as error:
                raise ValueError(f"cannot read chain.secret_file: {unreadable(error)}") from error
            if not secret:
                raise ValueError("chain.secret_file is empty")
            redaction.hide(secret)
            self.url = self.url.replace(_SECRET, secret)
            if self.websocket_url is not None:
                self.websocket_url = self.websocket_url.replace(_SECRET, secret)
            for address in filter(None, (self.url, self.websocket_url)):
                redaction.learn(address, path_is_secret=True)
        elif _SECRET in self.url + (self.websocket_url or ""):
            raise ValueError(f"{_SECRET} stands for the content of a file: set chain.secret_file")
        return self

    @property
    def shown_url(self) -> str:
        """`url` for people, without what may be secret."""
        return redaction.shown(self.url)


class InterfaceConfig(_Table):
    """What a robot's ROS 2 nodes offer in place of what the table of keys says."""

    gripper: Literal["gripper_command", "trajectory"] = "gripper_command"
    """`gripper_command`: `{ns}/gripper_controller/gripper_cmd`. `trajectory`: the controller of a trajectory,
    `{ns}/gripper_controller/follow_joint_trajectory`, which takes both fingers' positions and no force."""
    arm: bool = True
    """Whether it has an arm with two fingers. A robot without takes only work that needs none."""
    emergency_stop: Literal["set_bool", "husarion"] = "set_bool"
    """`set_bool`: `{ns}/emergency_stop`. `husarion`: the two triggers of Husarion's robots,
    `{ns}/hardware/e_stop_trigger` and `{ns}/hardware/e_stop_reset`."""


class SiteRobot(RobotConfig):
    """A robot of the site, with what its driver offers. No check reads `interface`."""

    interface: InterfaceConfig = InterfaceConfig()
    """What a robot with ROS 2 offers where it is not what the table of keys says."""


TRIGGER = "std_srvs/srv/Trigger"
GRIPPER_TRAJECTORY = Topic(
    "{ns}/gripper_controller/follow_joint_trajectory",
    FOLLOW_JOINT_TRAJECTORY.type,
    Form.ACTION,
    Plane.ROBOT,
    None,
    BODY,
)
STOP_TRIGGER, STOP_RESET = (
    Topic(f"{{ns}}/hardware/e_stop_{what}", TRIGGER, Form.SERVICE, Plane.ROBOT, None, BODY)
    for what in ("trigger", "reset")
)
INSTEAD = (GRIPPER_TRAJECTORY, STOP_TRIGGER, STOP_RESET)
"""What a robot may offer in place of keys of the table."""


def interface_of(robot: RobotConfig) -> InterfaceConfig:
    """What its driver offers."""
    return robot.interface if isinstance(robot, SiteRobot) else InterfaceConfig()


def interface_fault(robot: RobotConfig) -> str:
    """Why no driver of it can offer what its table says, as a sentence; empty if one can."""
    offered = interface_of(robot)
    if robot.body == "sim" and offered != InterfaceConfig():
        return 'robot_sim moves it, with an arm and the table of keys: write body = "ros2", or no interface'
    if not offered.arm and offered.gripper == "trajectory":
        return "a robot without an arm has no gripper: leave one of the two out"
    if not offered.arm and robot.kinematics is not None:
        return "kinematics describes an arm, and this robot has none: leave one of the two out"
    return ""


class FromHour(_Table):
    """What applies from an hour of the site's day (UTC) on, until that of the next in its list. Before the
    first, the last applies."""

    from_hour: int = Field(ge=0, le=23)


class TariffConfig(FromHour):
    """Price of a kilowatt-hour for the organization."""

    eur_kwh: Decimal = Field(ge=0)


class RateConfig(FromHour):
    """What one unit of a kind's measure is paid."""

    iec: Decimal = Field(gt=0, max_digits=28, decimal_places=18)


class TokenConfig(_Table):
    """A token that is on the chain already: any ERC-20 without hooks and fees, with or without permit."""

    address: Annotated[str, AfterValidator(typed_address)]
    decimals: int = Field(ge=MIN_DECIMALS, le=MAX_DECIMALS)
    """As the token says itself, which is checked."""


class EconomyConfig(_Table):
    """What the organization pays and charges, and how long it waits."""

    token: TokenConfig | None = None
    """What it pays with; by default IECoin, which is made at deployment and has 18 decimals. It counts when
    the contracts are deployed. Amounts are called IEC all the same."""
    initial_iec: Decimal = Decimal(2000)
    """Minted to the organization and to each robot at deployment, unless `token` is set."""
    supply_iec: Decimal = Decimal(1_000_000)
    """Total supply of IEC. The organization's administrator gets what the amounts above leave."""
    verdict_window_s: int = 48 * 3600
    """Verdict window, s, at least a minute. It is long compared with a verification, because it only frees
    the escrow if the oracle never answers. A simulated site skips hours in seconds while the robot
    charges."""
    audit_window_s: int = Field(default=7 * 24 * 3600, ge=0, le=30 * 24 * 3600)
    """How long after the verdict window a ruling may still be replaced, s: by the organization's auditors, to
    whom the oracle passes what it cannot decide. Both windows together are at most 30 days. It counts when a
    kind gets its first judge."""
    max_attempts: int = Field(default=3, ge=1, le=7)
    eur_per_iec: Decimal | None = Field(default=None, gt=0, max_digits=28, decimal_places=18)
    """What one IEC is worth. Wallets and tasks then show EUR beside IEC; nothing is paid by it. By default
    there is no such rate."""
    electricity: list[TariffConfig] = Field(
        default=[TariffConfig(from_hour=0, eur_kwh=Decimal("0.30"))], min_length=1
    )

    @property
    def currency(self) -> Currency:
        """What amounts on this site are of."""
        return IEC if self.token is None else Currency(self.token.decimals)


class BudgetConfig(_Table):
    """What all holders of a role together may take out of the treasury."""

    iec: Decimal = Field(ge=0, max_digits=28, decimal_places=18)
    """In one period."""
    period_s: int = Field(default=24 * 3600, gt=0, lt=2**24)


class TermsConfig(_Table):
    """What a service agrees to when it is registered."""

    bond_iec: Decimal = Field(default=Decimal(20), ge=0, max_digits=28, decimal_places=18)
    """Locked until the service retires."""
    penalty_iec: Decimal = Field(default=Decimal(5), ge=0, max_digits=28, decimal_places=18)
    """What a failed attempt takes from the bond; at most the bond."""
    max_failures: int = Field(default=3, ge=0, le=255)
    """Failures in a row of the provider that suspend the service; 0 for no limit."""

    @model_validator(mode="after")
    def _penalty_within_bond(self) -> Self:
        if self.penalty_iec > self.bond_iec:
            raise ValueError(
                f"the penalty, {self.penalty_iec} IEC, is higher than the bond, {self.bond_iec} IEC"
            )
        return self


MIN_VOTERS = 3
"""Members without whom nobody decides by vote; the contracts have the same number."""


class GovernanceConfig(_Table):
    """The party that decides about the organization, and how fast."""

    kind: Literal["administrator", "vote"] = "administrator"
    """The decisions that count: those of the key of `organization`, which proposes them, or of the members
    by vote. It counts when the contracts are deployed."""
    delay_s: int = Field(default=2 * 24 * 3600, ge=0, le=30 * 24 * 3600)
    """Time between a proposal of the administrator, or a decision of the members, and its execution, s:
    everybody can see it coming. 0, which only an administrator may have: its key acts at once. It counts when
    the contracts are deployed; `rodeo organization propose delay` changes it later."""
    members: list[str] = []
    """The first members where members decide, by the names of robots and participants: one vote each, and at
    least three."""
    voting_period_s: int = Field(default=3 * 24 * 3600, gt=0, lt=2**32)
    """For how long members may vote on a proposal, s."""
    quorum_percent: int = Field(default=25, ge=1, le=100)
    """Share of all members whose votes, for or abstaining, a decision needs: rounded up, at least two, and a
    majority of fewer than ten members."""
    guardian: str | None = "organization"
    """The participant whose key may pause new tasks for up to three days and take the right to judge from a
    judge, and nothing else. None: nobody."""
    budgets: dict[Literal["operator", "treasurer"], BudgetConfig] = {
        "operator": BudgetConfig(iec=Decimal(1000)),
        "treasurer": BudgetConfig(iec=Decimal(200)),
    }
    """Rewards and bonds that operators pay, and what treasurers withdraw. A role that is not listed has no
    limit."""
    terms: TermsConfig = TermsConfig()
    """Terms at the deployment. Later `rodeo organization terms` changes them."""


STAKE_COVERS = 10
"""`STAKE_COVERS` of DisputeJudge: a judge's stake covers accepted work of ten times its amount."""


class InstanceConfig(_Table):
    """A committee that decides about challenges of the verdicts of the one before it."""

    judges: list[str] = Field(min_length=1, max_length=64)
    """Participants who decide about challenges; each judges in one committee only."""
    votes: int = Field(ge=1)
    """How many of them have to agree: more than half of them, and more than had to before."""
    window_s: int = Field(default=3600, ge=60, le=7 * 24 * 3600)
    """For how long a verdict of the committee before can be challenged, s."""
    decision_s: int = Field(default=24 * 3600, ge=60, le=7 * 24 * 3600)
    """How long the judges may take, s. After it the verdict stands."""
    stake_iec: Decimal = Field(default=Decimal(20), gt=0, max_digits=36, decimal_places=18)
    """What a challenge costs whoever is wrong."""
    judge_stake_iec: Decimal = Field(default=Decimal(20), ge=0, max_digits=36, decimal_places=18)
    """What each judge of the committee before, at first an oracle, must have deposited for its vote to count,
    and loses if a challenge overturns the ruling; 0 for none. It covers ten times as much of accepted work
    that can still be challenged; a vote for more waits. The organization's administrator deposits it when the
    contracts are deployed."""


class AppealConfig(InstanceConfig):
    """The committee that decides when the decision about a challenge is challenged, too. Nothing overturns
    that."""

    decision_s: int = Field(default=12 * 3600, ge=60, le=7 * 24 * 3600)
    """How long the judges may take, s. By default all fits into the default of `economy.verdict_window_s`."""
    stake_iec: Decimal = Field(default=Decimal(40), gt=0, max_digits=36, decimal_places=18)
    """What it costs whoever is wrong: more than the challenge before."""


class DisputesConfig(InstanceConfig):
    """How verdicts of the site's oracles can be challenged. It counts when the contracts are deployed."""

    appeal: AppealConfig | None = None
    """By default nothing overturns what the judges of challenges decide."""

    @property
    def instances(self) -> list[InstanceConfig]:
        """The committees that decide about challenges, one after the other."""
        return [self] if self.appeal is None else [self, self.appeal]

    @property
    def longest_s(self) -> int:
        """From the first ruling to the payment, s: as `DisputeJudge.longestCase` says."""
        return sum(one.window_s + one.decision_s for one in self.instances)


class WalletLimits(_Table):
    """What a wallet may spend. None is no limit; a day is 24 h of block time."""

    max_fee_per_gas_gwei: Decimal | None = Field(default=None, gt=0)
    max_fee_eth: Decimal | None = Field(default=None, gt=0, max_digits=36, decimal_places=18)
    """Maximum fee of one transaction: its gas limit times its max fee per gas. The gas limit is lowered for
    it, down to a quarter above the estimate."""
    daily_fee_eth: Decimal | None = Field(default=None, ge=0, max_digits=36, decimal_places=18)
    """Maximum of fees in a day. Until it is mined, a transaction counts with its maximum."""
    daily_iec: Decimal | None = Field(default=None, ge=0, max_digits=36, decimal_places=18)
    """Maximum of rewards, transfers, withdrawals, deposits, stakes and bonds in a day. What comes back, such
    as the reward of a cancelled task, is not subtracted. With this limit a wallet names no payout address but
    the site file's, and signs nothing that others send. Each bridge counts only what it signs."""


class BridgeConfig(_Table):
    """What holds for every bridge of the site."""

    shared_wallets: list[str] = []
    """Participants whose wallets also send transactions without this site's bridges, for example for another
    organization on the same chain. A bridge does not check that its journal holds all they have sent."""
    database: Annotated[str, AfterValidator(_with_password)] | None = None
    """SQLAlchemy URL of the index, e.g. `postgresql+psycopg://user@host/rodeo`; a SQLite file by default. The
    password can also stand in PostgreSQL's password file (`~/.pgpass`)."""
    max_behind_s: float = Field(default=10.0, gt=0)
    """Wall time after which the bridge is not ready if its index is behind the node or the node does not
    answer."""
    stuck_s: float = Field(default=30.0, gt=0)
    """Wall time after which the bridge replaces a pending transaction with one at a higher fee."""
    limits: dict[str, WalletLimits] = {}
    """Participant -> spending limits of its wallet."""


class OtherBridgeConfig(_Table):
    """A bridge besides the site's own one, which is called `bridge`, on a computer of its own. It signs and
    sends, and publishes nothing."""

    name: str = Field(pattern=r"^[a-z][a-z0-9-]{0,30}$")
    wallets: list[str] | None = Field(default=None, min_length=1)
    """Participants whose wallets it manages in place of the site's own bridge. By default those of the site's
    oracles: whoever takes over one computer cannot post tasks and accept their proofs."""


KindName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]


class ParticipantConfig(_Table):
    """Somebody with a wallet besides the organization, its oracle and its robots."""

    name: str = Field(pattern=r"^[a-z][a-z0-9-]{0,63}$")
    address: str | None = Field(default=None, pattern=r"^0x[0-9a-fA-F]{40}$")
    """Address of a participant who signs with a wallet elsewhere; the bridge only broadcasts. Without an
    address the bridge signs with the participant's keystore."""
    kinds: list[KindName] | None = None
    """Kinds of work that the participant may offer. By default the kinds that people judge, because a person
    has no machine for the others. List other kinds if the participant's own program does them."""


class RosConfig(_Table):
    """A process that speaks ROS 2 for the participants of one owner: tasks, services and money as interfaces
    of `rodeo_msgs`, below `/<org>/<participant>/`."""

    owner: str = Field(pattern=r"^[a-z][a-z0-9-]{0,30}$")
    """Name of the process beside others: `ros_dao.<owner>`."""
    participants: list[str] = Field(min_length=1)
    """Robots and participants of this owner. Only a node with the certificate `node.<participant>` may give a
    participant's commands. The organization has none: its people use console and command line."""


class PeopleConfig(_Table):
    """On a simulated site, whose time goes faster than theirs."""

    min_window_s: float = Field(default=3600.0, ge=0)
    """Least wall time for a person to do a task or to judge a proof. Meanwhile the simulator slows the clock
    down accordingly, but never below real time: a window that is shorter on chain stays shorter. 0 never
    slows the clock down."""


class MetricsConfig(_Table):
    """Each process serves `/metrics`, `/livez` and `/readyz` (rodeo.runtime.metrics_server)."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    ports: dict[str, Annotated[int, Field(ge=0, le=65535)]] = {}
    """Process -> port. A process without an entry takes a free port and shows it in its status."""


class DiskConfig(_Table):
    """Free disk space. While there is less, a process that writes is not ready and starts nothing new."""

    min_free_mb: float = Field(default=200.0, ge=0)
    """Free space needed on each file system that a process writes to: data, logs, a store that is a folder.
    On a small file system a twentieth of its size is enough."""


def _storage_url(text: str) -> str:
    redaction.learn(text)
    if not urlsplit(text).scheme or "://" not in text:
        raise ValueError("this is no URL such as file:///var/lib/rodeo/store or s3://bucket/store")
    if urlsplit(text).password or urlsplit(text).query:
        raise ValueError("every proof's address on chain begins with this URL: leave password and query out")
    return text


StoreUrl = Annotated[str, AfterValidator(_storage_url)]


class StoreConfig(_Table):
    url: StoreUrl | None = None
    """fsspec URL where proofs and reports go; the data directory's `store` folder by default."""
    allowed: list[StoreUrl] = []
    """Further URL prefixes that a proof may be fetched from."""
    options: dict[str, Any] = {}
    """Options of fsspec's client for URLs with the scheme of `url`, or of `allowed` where `url` is a folder
    ({ endpoint_url = "..." } for S3). Credentials do not belong here."""

    @field_validator("options")
    @classmethod
    def _texts_are_hidden(cls, options: dict[str, Any]) -> dict[str, Any]:
        for name, value in options.items():
            if isinstance(value, str) and re.search("key|secret|token|password", name):
                redaction.hide(value)
        return options

    max_bytes: int = 256 * MiB
    scrub_days: float = Field(default=7.0, gt=0)
    """Days of wall time in which the oracle hashes every file in the store that a verdict names once."""


class OracleConfig(_Table):
    cpu_limit_s: float = Field(default=60.0, gt=0)
    """CPU time limit of one verification. It is four times the cost of the worst proof within the limits of
    `rodeo.checks.counts`. The oracle tries a verification that exceeds it once more, then gives up on it:
    nobody is paid or fined."""
    time_limit_s: float = Field(default=600.0, gt=0)
    """Wall time limit of one verification, for one that hangs. The consequences are the same; where the store
    has not sent the proof by then, the oracle waits for the store."""
    handover_s: float = Field(default=3600.0, gt=0)
    """Wall time for an executor to send a submitted proof that the store does not have, counted from the
    oracle's request and ending when the verdict is due. After it the oracle rejects the proof."""
    panel: int | None = Field(default=None, ge=1)
    """How many of several `[[oracles]]` may vote on a proof at once; all by default. The others stand in."""
    rotation_s: int = Field(default=0, ge=0, lt=2**32)
    """Seconds of the chain's time after a proof after which one more of the others may vote. 0 for never."""
    verdict_within_s: float = Field(default=240.0, gt=0)
    """Wall time until the verdict on a submission in the worst case: two verifications up to the CPU time
    limit, and the same again for an earlier submission that it waits for."""


class JudgeConfig(_Table):
    """One of several oracles: a process of its own with a key of its own, which signs votes."""

    name: str = Field(pattern=r"^[a-z][a-z0-9-]{0,30}$")
    owner: str | None = None
    """Robot or participant for whom it works. It never judges that one's tasks. By default it works for
    nobody."""


class MaintenanceConfig(_Table):
    """Maintenance by people: the robot posts such a task each time it has driven `every_km`.

    Auditors judge it: no oracle sees whether it was done.
    """

    kind: KindName
    every_km: float = Field(gt=0)
    reward_iec: Decimal = Field(ge=0)
    description: str = Field(max_length=2000)
    execution_window_s: int = Field(default=24 * 3600, gt=0)
    rise: Rise | None = None
    """How the reward rises while nobody takes the task; by default not at all."""


class KindConfig(_Table):
    """A kind of work that the organization knows.

    With a `judge` the table itself declares the kind, which has neither behaviour nor checks. Without one it
    names an installed package, which sets who judges. The package also sets every field left out here.
    """

    name: KindName
    judge: Literal["auditor"] | None = None
    title: str = Field(default="", max_length=80)
    description: str = Field(default="", max_length=2000)
    parameters: dict[str, Any] = {}
    """JSON Schema (draft 2020-12) of a task's parameters."""
    price_iec: Decimal | None = Field(default=None, ge=0)
    """What the work costs if nobody says otherwise. From the founding on an attempt counts in its provider's
    record up to this, or up to 100 IEC if there is no price; later `rodeo organization kind` changes it."""
    execution_window_s: int | None = Field(default=None, ge=60, le=30 * 86_400)
    min_window_s: int | None = Field(default=None, ge=60, le=30 * 86_400)
    """The shortest execution window of a task, s. It holds on chain from the founding on; later `rodeo
    organization kind` changes it. The next two likewise."""
    max_window_s: int | None = Field(default=None, ge=60, le=30 * 86_400)
    """The longest, s."""
    grace_s: int | None = Field(default=None, ge=0, le=2550, multiple_of=10)
    """How long an executor may give a task back so that the attempt does not count, s, at most half of the
    shortest window. 0: three minutes, or half of that window if it is less or people do the work."""
    votes: int | None = Field(default=None, ge=1)
    """How many of several `[[oracles]]` have to agree on a proof of this kind; by default more than half of
    the panel."""
    models_sha256: list[Annotated[str, Field(pattern=r"^0x[0-9a-f]{64}$")]] = []
    """Networks whose word counts beside the installed one, by the hash of their files. They are part of the
    kind's rules: where a witness asked any other, auditors judge the work."""
    rates: list[RateConfig] = []
    """Pay by quantity, at most the agreed price; without rates the price is for the whole task. Part of the
    kind's rules."""
    oracle_below_iec: Decimal = Field(default=Decimal(0), ge=0)
    """Below this price the oracle also accepts work of which a part is the executor's word alone, such as the
    cleaning of a place. At this price and above auditors decide about it. It is no part of the kind's rules:
    all oracles of an organization have the same, as of the lab."""

    post_seen_as: str | None = None
    """Participant whose wallet posts a task about each thing that a robot sees, without a person, at
    `price_iec`. What it spends in a day is its `daily_iec` in [bridge.limits]. By default people post."""

    @model_validator(mode="after")
    def _says_who_judges(self) -> KindConfig:
        if self.judge is not None and self.models_sha256:
            raise ValueError(f"auditors judge {self.name}, and no network: remove models_sha256")
        if self.judge is not None and self.rates:
            raise ValueError(f"auditors say what {self.name} is paid: remove rates")
        if self.judge is None and (self.title or self.description or self.parameters):
            raise ValueError(
                f'{self.name} is declared here: add judge = "auditor" to set who judges it, '
                "or remove title, description and parameters, which its package sets"
            )
        return self


class DemoConfig(_Table):
    """The task that `rodeo demo` posts and pays for."""

    kind: KindName
    params: dict[str, Any] = {}
    """Parameters of the task. The kind fills in the missing ones."""


class GasPrices(_Table):
    """What a chain would charge for the gas that was used, by a named price."""

    name: str = Field(max_length=40)
    gas_gwei: Decimal = Field(ge=0)
    """Price of a unit of gas, base fee and tip. A rollup's charge for its data is not in it."""


class ExperimentConfig(_Table):
    """The days that `rodeo experiment paper` runs on this site. Its report prints every number."""

    kind: KindName
    """The organization has this done for each item that somebody leaves on the floor."""
    emptying: KindName
    """A person does this when the bin has taken `empty_after` items. Auditors judge it."""
    person: str
    """The participant who empties the bin."""
    emptying_iec: Decimal = Field(default=Decimal(20), ge=0)
    empty_after: int = Field(default=6, ge=1)
    emptying_min: float = Field(default=10.0, gt=0)
    """Minutes of site time from the assignment until the person is done, and again until it is judged."""
    days: int = Field(default=3, ge=1, le=14)
    arrivals: int = Field(default=51, ge=0)
    """Items in all days. They arrive at random between the first and the last of `arrival_hours`."""
    arrival_hours: tuple[float, float] = (8.5, 17.5)
    """Hours of the local day (the first robot's time zone), the first before the last."""
    deposit_iec: Decimal = Field(default=Decimal(5000), ge=0)
    """The administrator adds this to the treasury before the first arrival."""
    gas_prices: list[GasPrices] = []
    eth_eur: Decimal = Field(default=Decimal(3700), ge=0)
    slow_limits: dict[str, float] = {}
    """Motion limits of the robots with `--pace paper`, and in the calibrated run."""
    calibrated_idle_power_w: float | None = Field(None, gt=0)
    """Base load of the robots in the calibrated run, W. None: the site has no calibrated run."""
    unlisted: dict[str, Any] = {}
    """Tables of the site file with the settings that differ with `--unlisted`."""
    unnoticed_min: float = Field(default=30.0, ge=0)
    """Minutes of site time after which a person posts a task for a thing that is listed nowhere, if no robot
    has found it."""
    pointing_error_m: float = Field(default=0.05, ge=0, le=0.1)
    """Standard deviation of the place that this person names, east and north."""

    @field_validator("arrival_hours")
    @classmethod
    def _in_a_day(cls, hours: tuple[float, float]) -> tuple[float, float]:
        if not 0 <= hours[0] < hours[1] <= 24:
            raise ValueError(f"not hours of a day, the first before the last: {hours[0]:g}, {hours[1]:g}")
        return hours


class ConsoleConfig(_Table):
    """The web page and its interface for programs."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: int = Field(default=8088, ge=0, le=65535)
    """0 takes a free port. The process's status shows it."""
    origin: str | None = Field(default=None, pattern=r"^https://[^/]+$")
    """Address that people open in the browser if a TLS proxy is in front of the console, for example
    "https://console.example.org". Without it only this machine can reach the console."""
    trusted_proxies: list[str] = []
    """Addresses of proxies whose X-Forwarded-For header the console trusts."""
    session_idle_s: float = Field(default=30 * 60, gt=0)
    """Wall time without a click after which a person has to log in again."""
    session_max_s: float = Field(default=12 * 3600, gt=0)
    """Wall time after which a person has to log in again, even if active."""


class AgentConfig(_Table):
    charge_below: float = Field(default=0.5, ge=0, le=1)
    """State of charge under which an idle robot buys a charge."""
    charge_target: float = Field(default=0.95, gt=0, le=1)
    explore_when_idle: bool = True
    explore_min_per_h: float = Field(default=60.0, ge=0, le=60)
    """Minutes of each hour that an idle robot may explore. A simulated clock cannot skip this time."""
    look_when_exploring: bool = True
    """Whether it then looks around, and reports what lies on the floor that no site file lists."""
    daily_spending_cap_iec: Decimal = Field(default=Decimal(1000), ge=0)
    """IEC that a robot may spend on tasks of its own within 24 hours of site time."""
    maintenance: list[MaintenanceConfig] = []
