"""Everything that a person or a program can have done here, with the roles that may: one table for both.

Pages and the REST interface call `Actions.perform` and nothing else that changes anything.
"""

from __future__ import annotations

import inspect
import logging
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from pydantic import Base64Bytes, BaseModel, Field, StringConstraints, create_model

from rodeo.access.accounts import MAX_PASSPHRASE, MIN_PASSPHRASE, Accounts, Mark, User, require_participant
from rodeo.access.roles import Role
from rodeo.bus.messages import Fault, Id, Message, Payment, Ruling
from rodeo.bus.seen import Saying, Seen
from rodeo.bus.session import Bus, validate
from rodeo.commands import COMMANDS, Command
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import Participant
from rodeo.errors import InvalidRequest, NoResponder, RodeoError
from rodeo.host.clock import Clock
from rodeo.kinds import Kinds
from rodeo.person.statement import MAX_NOTE_CHARACTERS, MAX_PHOTOS, Executor, judge
from rodeo.signing import keystores
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.text.strict_json import Json
from services.console.errors import Forbidden, RobotUnavailable
from services.console.posting import problems

log = logging.getLogger(__name__)

ORGANIZATION = "organization"
_COMMAND_S = 40.0
_ROBOT_S = 5.0

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Passphrase = Annotated[str, StringConstraints(min_length=MIN_PASSPHRASE, max_length=MAX_PASSPHRASE)]


class RobotRequest(Message):
    robot: Name


class Account(Message):
    name: Name
    roles: frozenset[Role] = frozenset()
    participant: Name | None = None
    """The wallet that an executor works with."""


class NewUser(Account):
    passphrase: Passphrase


class ChangedUser(Account):
    disabled: bool = False


class NewPassphrase(Message):
    name: Name
    passphrase: Passphrase
    current: Annotated[str, StringConstraints(max_length=MAX_PASSPHRASE)] | None = None
    """Asked of those who change their own: a token or an open page is not enough to take an account over."""


class NewToken(Message):
    label: Annotated[str, StringConstraints(min_length=1, max_length=64)]


class TokenId(Message):
    token_id: Id


class NewMark(Message):
    chain: Annotated[str, StringConstraints(max_length=128)]
    """Genesis hash."""
    seq: Id
    """Number of the last event that was read."""
    heard_s: float = Field(ge=0, le=1e12)
    """Wall time until which everything was read that processes reported."""


class TaskId(Message):
    task_id: Id


class SubmitWork(Message):
    task_id: Id
    note: Annotated[str, StringConstraints(min_length=1, max_length=MAX_NOTE_CHARACTERS)]
    photos: list[Base64Bytes] = Field(default_factory=list, max_length=MAX_PHOTOS)
    """JPEG or PNG."""


class Judge(Message):
    task_id: Id
    ruling: Ruling
    fault: Fault = "nobody"
    """The party at fault for a void task."""
    reason: Annotated[str, StringConstraints(min_length=1, max_length=500)]
    amount_iec: Payment | None = None
    """What accepted work is paid; the agreed price by default."""


class Nothing(Message):
    pass


Perform = Callable[["Actions", User, Any], Json]


@dataclass(frozen=True)
class Action:
    name: str
    summary: str
    model: type[BaseModel]
    roles: frozenset[Role]
    """Any of them may; empty: everybody who is logged in."""
    run: Perform


class Actions:
    """Carries out actions for people whose roles allow them. Its methods block; call them from a thread."""

    def __init__(self, bus: Bus, site: Site, kinds: Kinds, accounts: Accounts, clock: Clock) -> None:
        self._clock = clock
        self.bus = bus
        self.site = site
        self.kinds = kinds
        self.accounts = accounts

    def perform(self, user: User, name: str, request: BaseModel | Json) -> Json:
        """Raises Forbidden, InvalidRequest, and the errors of the bus and of the process that does it."""
        action = ACTIONS[name]
        # The present roles, not those when the page was opened: some may have been taken since.
        user = self.accounts.user(user.name)
        if user.disabled or (action.roles and not user.has(*action.roles)):
            raise Forbidden(
                f"this needs the role {' or '.join(sorted(action.roles))}",
                action=name,
                roles=sorted(user.roles),
            )
        if not isinstance(request, action.model):
            request = validate(action.model, request)
        log.info("%s: %s", user.name, name)
        return action.run(self, user, request)

    def doubt(self, request: RegisterTask) -> str:
        """Why the task can probably not be done as it says; empty for what seems right."""
        organization = Participant(self.bus, self.site.org, ORGANIZATION)
        return organization.doubt(self.kinds.get(request.kind), request.params)

    # -- what they become ------------------------------------------------------------------------------

    def command(self, participant: str, name: str, request: BaseModel) -> Json:
        """A transaction of this participant through the bridge."""
        key = topics.COMMAND.name(org=self.site.org, participant=participant, command=name)
        body = request.model_dump(mode="json", exclude_unset=True, exclude={"participant"})
        return self.bus.query(key, body, timeout_s=_COMMAND_S)

    def executor(self, user: User) -> Executor:
        """The executor that this person works as. Raises Forbidden, WalletError when the key is not on this
        site."""
        if user.participant is None:
            raise Forbidden("your account has no participant; an administrator can set one")
        participant = Participant(self.bus, self.site.org, user.participant)
        return Executor(self.site, participant, keystores.open_key(self.site, user.participant), self._clock)

    def robot(self, robot: str, order: str) -> Json:
        """An operator's order to a robot's agent. Raises ConfigError for a stranger, RobotUnavailable."""
        self.site.robot(robot)
        try:
            return self.bus.query(
                topics.ROBOT_ORDER.name(org=self.site.org, robot=robot, order=order), {}, timeout_s=_ROBOT_S
            )
        except NoResponder as error:
            raise RobotUnavailable("the robot's agent does not answer", robot=robot) from error

    def stop_all(self) -> Json:
        """Stop every robot; returns which did not hear."""
        stopped: list[str] = []
        silent: dict[str, str] = {}
        for robot in self.site.robots:
            try:
                self.robot(robot.name, "stop")
                stopped.append(robot.name)
            except RodeoError as error:
                # The others must be stopped all the same.
                silent[robot.name] = error.message
        return {"stopped": stopped, "silent": silent}


def speaks_for(user: User, participant: str) -> bool:
    """Whether this person may act in the name of `participant`."""
    own = participant == user.participant and user.has(Role.EXECUTOR)
    return own or (participant == ORGANIZATION and user.has(Role.OPERATOR)) or user.has(Role.ADMINISTRATOR)


def proposer_of(user: User, decided_by: str) -> str | None:
    """In whose name this person proposes: a member in its own, an administrator in the organization's."""
    if decided_by == "administrator":
        return ORGANIZATION if user.has(Role.ADMINISTRATOR) else None
    return user.participant if user.has(Role.EXECUTOR) and user.participant != ORGANIZATION else None


def _proposes_for(user: User, participant: str) -> bool:
    return participant in (proposer_of(user, "administrator"), proposer_of(user, "vote"))


def _named(may: Callable[[User, str], bool], user: User, request: Any) -> str:
    """The participant that the request names. Raises Forbidden."""
    if not may(user, request.participant):
        raise Forbidden("your account may not act for this participant", participant=request.participant)
    return str(request.participant)


_WALLETS: dict[str, Callable[[User, Any], str]] = {
    "organization": lambda _user, _request: ORGANIZATION,
    "provider": partial(_named, speaks_for),
    "proposer": partial(_named, _proposes_for),
    # Only in one's own name: a console administrator does not vote for others.
    "member": lambda user, _request: user.participant or ORGANIZATION,
    # The contracts take it from everybody. People with a wallet of their own pay for it themselves.
    "anybody": lambda user, _: (user.participant if user.has(Role.EXECUTOR) else None) or ORGANIZATION,
}


def _command(wallet: str, name: str) -> Perform:
    return lambda actions, user, request: actions.command(_WALLETS[wallet](user, request), name, request)


def _post_task(actions: Actions, _user: User, request: RegisterTask) -> Json:
    wrong = problems(actions.site, actions.kinds, request)
    if wrong:
        raise InvalidRequest("the task's parameters are not valid", fields=wrong)
    doubt = actions.doubt(request)
    reply = actions.command(ORGANIZATION, "register_task", request)
    return reply | ({"warning": doubt} if doubt else {})


def _of_robot(order: str) -> Perform:
    return lambda actions, _user, request: actions.robot(request.robot, order)


def _accept_work(actions: Actions, user: User, request: TaskId) -> Json:
    return {"task_id": actions.executor(user).accept(request.task_id).id}


def _submit_work(actions: Actions, user: User, request: SubmitWork) -> Json:
    executor = actions.executor(user)
    # Handing in implies accepting; doing both changes nothing.
    executor.accept(request.task_id)
    return {"proof_sha256": executor.submit(request.task_id, request.note, request.photos)}


def _judge(actions: Actions, user: User, request: Judge) -> Json:
    auditor = Participant(actions.bus, actions.site.org, user.participant or ORGANIZATION)
    said = request.task_id, request.ruling, request.reason, request.amount_iec, request.fault
    judge(actions.site, auditor, *said)
    return {"task_id": request.task_id, "ruling": request.ruling}


def _say_of_seen(actions: Actions, user: User, request: Saying) -> Json:
    seen = Seen(actions.bus, actions.site.org, user.name)
    return seen.say(request.id, request.what).model_dump(mode="json")


def _create_user(actions: Actions, _user: User, request: NewUser) -> Json:
    require_participant(actions.site, request.roles, request.participant)
    actions.accounts.add_user(request.name, request.passphrase, request.roles, request.participant)
    return {"name": request.name}


def _change_user(actions: Actions, user: User, request: ChangedUser) -> Json:
    if request.name == user.name and (request.disabled or Role.ADMINISTRATOR not in request.roles):
        raise InvalidRequest(
            "another administrator must change your account", fields={"name": "your own account"}
        )
    if not request.disabled:
        require_participant(actions.site, request.roles, request.participant)
    actions.accounts.change_user(request.name, request.roles, request.participant, request.disabled)
    return {"name": request.name}


def _set_passphrase(actions: Actions, user: User, request: NewPassphrase) -> Json:
    if request.name != user.name and not user.has(Role.ADMINISTRATOR):
        raise Forbidden("only an administrator may change somebody else's passphrase", name=request.name)
    if request.name == user.name and not actions.accounts.is_passphrase(user.name, request.current or ""):
        raise InvalidRequest(
            "the current passphrase is wrong", fields={"current": "enter the one you log in with"}
        )
    actions.accounts.set_passphrase(request.name, request.passphrase)
    return {"name": request.name}


def _issue_token(actions: Actions, user: User, request: NewToken) -> Json:
    return {"token": actions.accounts.issue_token(user.name, request.label), "label": request.label}


def _revoke_token(actions: Actions, user: User, request: TokenId) -> Json:
    actions.accounts.revoke_token(user.name, request.token_id)
    return {"token_id": request.token_id}


def _mark_read(actions: Actions, user: User, request: NewMark) -> Json:
    actions.accounts.set_mark(user.name, Mark(**request.model_dump()))
    return {"name": user.name}


_ADMINISTRATOR = frozenset({Role.ADMINISTRATOR})
_OPERATOR = frozenset({Role.OPERATOR})
_EXECUTOR = frozenset({Role.EXECUTOR})
_AUDITOR = frozenset({Role.AUDITOR})
_ANYBODY: frozenset[Role] = frozenset()


def summary_of(model: type[Command]) -> str:
    """The first sentence of what a command does."""
    return re.split(r"\.(?:\s|$)", inspect.cleandoc(model.__doc__ or ""))[0].replace("\n", " ")


def _declared() -> Iterator[Action]:
    """The commands that are declared for the console, each under its own name."""
    for name, model in COMMANDS.items():
        if (console := model.declared.console) is None:
            continue
        summary, body = summary_of(model), model
        # An operator, or an administrator, speaks for the organization, an executor for itself.
        if console.wallet in ("provider", "proposer"):
            body = create_model(model.__name__, __base__=model, participant=(Name, ORGANIZATION))
        yield Action(name, summary, body, frozenset(map(Role, console.roles)), _command(console.wallet, name))


_TABLE = (
    *_declared(),
    Action("post_task", "Post a task; its reward goes into escrow", RegisterTask, _OPERATOR, _post_task),
    Action("pause_robot", "Pause a robot: it finishes its attempt, then waits", RobotRequest, _OPERATOR,
           _of_robot("pause")),
    Action("resume_robot", "Resume a paused or stopped robot", RobotRequest, _OPERATOR,
           _of_robot("resume")),
    Action("charge_robot", "Have a robot buy a charge now", RobotRequest, _OPERATOR, _of_robot("charge")),
    Action("cancel_robot", "Have a robot give up its attempt", RobotRequest, _OPERATOR, _of_robot("cancel")),
    Action("stop_robot", "Stop a robot at once", RobotRequest, _OPERATOR, _of_robot("stop")),
    Action("stop_all", "Stop every robot at once", Nothing, _OPERATOR, lambda by, *_: by.stop_all()),
    Action("accept_work", "Accept a task that is assigned to you", TaskId, _EXECUTOR, _accept_work),
    Action("submit_work", "Submit a note and photos as the proof of your work", SubmitWork, _EXECUTOR,
           _submit_work),
    Action("judge", "Rule on a proof that waits for an auditor", Judge, _AUDITOR, _judge),
    Action("say_of_seen", "Say what something is that a robot has seen on the floor", Saying, _OPERATOR,
           _say_of_seen),
    Action("create_user", "Make an account for a person", NewUser, _ADMINISTRATOR, _create_user),
    Action("change_user", "Change roles or disable an account", ChangedUser, _ADMINISTRATOR, _change_user),
    Action("set_passphrase", "Set a new passphrase", NewPassphrase, _ANYBODY, _set_passphrase),
    Action("issue_token", "Create a token for a program of yours", NewToken, _ANYBODY, _issue_token),
    Action("mark_read", "Remember how far you have read events and alarms", NewMark, _ANYBODY, _mark_read),
    Action("revoke_token", "Revoke one of your tokens", TokenId, _ANYBODY, _revoke_token),
)  # fmt: skip

ACTIONS: dict[str, Action] = {action.name: action for action in _TABLE}
assert len(ACTIONS) == len(_TABLE), "names of actions must be unique"
