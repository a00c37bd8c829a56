"""Everything that a person or a program can have done here, with the roles that may: one table for both.

Pages and the REST interface call `Actions.perform` and nothing else that changes anything.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, Field, StringConstraints

from rodeo import topics
from rodeo.bus import Bus, validate
from rodeo.config import Site
from rodeo.errors import InvalidRequest, NoResponder
from rodeo.messages import (
    CancelTask,
    Message,
    RegisterService,
    RegisterTask,
    Transfer,
    UpdateService,
)
from services.console.accounts import Accounts, User
from services.console.errors import Forbidden, RobotUnavailable
from services.console.posting import problems
from services.console.roles import Role

log = logging.getLogger(__name__)

ORGANIZATION = "organization"
_COMMAND_S = 40.0
_ROBOT_S = 5.0

Json = dict[str, Any]
Text64 = Annotated[
    str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
]
Passphrase = Annotated[str, StringConstraints(min_length=12, max_length=256)]


class RobotRequest(Message):
    robot: Text64


class NewUser(Message):
    name: Text64
    passphrase: Passphrase
    roles: frozenset[Role] = frozenset()
    participant: Text64 | None = None
    """Whose wallet an executor works with."""


class ChangedUser(Message):
    name: Text64
    roles: frozenset[Role] = frozenset()
    participant: Text64 | None = None
    disabled: bool = False


class NewPassphrase(Message):
    name: Text64
    passphrase: Passphrase


class NewToken(Message):
    label: Annotated[str, StringConstraints(min_length=1, max_length=64)]


class TokenId(Message):
    token_id: Annotated[int, Field(ge=0, lt=2**63)]


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
    spends: bool = False
    """Moves money or gives rights: a page asks again before it does this."""


class Actions:
    """Carries out actions for people whose roles allow them. Its methods block; call them from a thread."""

    def __init__(self, bus: Bus, site: Site, accounts: Accounts) -> None:
        self._bus = bus
        self.site = site
        self.accounts = accounts

    def may(self, user: User, name: str) -> bool:
        action = ACTIONS[name]
        return not action.roles or user.has(*action.roles)

    def perform(self, user: User, name: str, request: BaseModel | Json) -> Json:
        """Raises Forbidden, InvalidRequest, and what the bus and the one who does it answer."""
        action = ACTIONS[name]
        # Not what the page knew when it was opened: roles may have been taken since.
        user = self.accounts.user(user.name)
        if user.disabled or not self.may(user, name):
            raise Forbidden(
                f"this needs the role {' or '.join(sorted(action.roles))}",
                action=name,
                roles=sorted(user.roles),
            )
        if not isinstance(request, action.model):
            request = validate(action.model, request)
        log.info("%s: %s", user.name, name)
        return action.run(self, user, request)

    # -- what they become ------------------------------------------------------------------------------

    def command(self, participant: str, name: str, request: BaseModel) -> Json:
        """A transaction of this participant through the bridge."""
        key = topics.COMMAND.name(org=self.site.org, participant=participant, command=name)
        body = request.model_dump(mode="json", exclude_unset=True)
        return self._bus.query(key, body, timeout_s=_COMMAND_S)

    def robot(self, robot: str, command: str) -> Json:
        """An operator's word to a robot's agent. Raises ConfigError for a stranger, RobotUnavailable."""
        self.site.robot(robot)
        try:
            return self._bus.query(f"rodeo/{self.site.org}/robot/{robot}/{command}", {}, timeout_s=_ROBOT_S)
        except NoResponder as error:
            raise RobotUnavailable(
                "the robot's agent does not answer; is its process running?", robot=robot
            ) from error

    def stop_all(self) -> Json:
        """Every robot at once; says who did not hear."""
        stopped, silent = [], {}
        for robot in self.site.robots:
            try:
                self.robot(robot.name, "stop")
                stopped.append(robot.name)
            except Exception as error:  # noqa: BLE001 - the others must be stopped all the same
                silent[robot.name] = str(error)
        return {"stopped": stopped, "silent": silent}


def _of_organization(command: str) -> Perform:
    return lambda actions, _user, request: actions.command(ORGANIZATION, command, request)


def _post_task(actions: Actions, _user: User, request: RegisterTask) -> Json:
    wrong = problems(actions.site, request)
    if wrong:
        raise InvalidRequest("the task cannot be posted like this", fields=wrong)
    return actions.command(ORGANIZATION, "register_task", request)


def _of_robot(command: str) -> Perform:
    return lambda actions, _user, request: actions.robot(request.robot, command)


def _stop_all(actions: Actions, _user: User, _request: Nothing) -> Json:
    return actions.stop_all()


def _create_user(actions: Actions, _user: User, request: NewUser) -> Json:
    actions.accounts.add_user(request.name, request.passphrase, request.roles, request.participant)
    return {"name": request.name}


def _change_user(actions: Actions, _user: User, request: ChangedUser) -> Json:
    actions.accounts.change_user(request.name, request.roles, request.participant, request.disabled)
    return {"name": request.name}


def _set_passphrase(actions: Actions, user: User, request: NewPassphrase) -> Json:
    if request.name != user.name and not user.has(Role.ADMINISTRATOR):
        raise Forbidden("only an administrator may change somebody else's passphrase", name=request.name)
    actions.accounts.set_passphrase(request.name, request.passphrase)
    return {"name": request.name}


def _issue_token(actions: Actions, user: User, request: NewToken) -> Json:
    return {"token": actions.accounts.issue_token(user.name, request.label), "label": request.label}


def _revoke_token(actions: Actions, user: User, request: TokenId) -> Json:
    actions.accounts.revoke_token(user.name, request.token_id)
    return {"token_id": request.token_id}


_ADMINISTRATOR = frozenset({Role.ADMINISTRATOR})
_OPERATOR = frozenset({Role.OPERATOR})
_TREASURER = frozenset({Role.TREASURER})

_TABLE = (
    Action("post_task", "Post a task; its reward goes into escrow", RegisterTask, _OPERATOR,
           _post_task, spends=True),
    Action("cancel_task", "Cancel a task that nobody has; its reward comes back", CancelTask, _OPERATOR,
           _of_organization("cancel_task")),
    Action("register_service", "Offer a service of the organization", RegisterService, _OPERATOR,
           _of_organization("register_service")),
    Action("update_service", "Price, pause, resume or retire a service of the organization", UpdateService,
           _OPERATOR, _of_organization("update_service")),
    Action("transfer", "Pay somebody from the organization's account", Transfer, _TREASURER,
           _of_organization("transfer"), spends=True),
    Action("pause_robot", "Let a robot finish its step and then wait", RobotRequest, _OPERATOR,
           _of_robot("pause")),
    Action("resume_robot", "Let a paused robot go on", RobotRequest, _OPERATOR, _of_robot("resume")),
    Action("charge_robot", "Send a robot to its dock", RobotRequest, _OPERATOR, _of_robot("charge")),
    Action("cancel_robot", "Have a robot give up what it does", RobotRequest, _OPERATOR, _of_robot("cancel")),
    Action("stop_robot", "Stop a robot at once", RobotRequest, _OPERATOR, _of_robot("stop")),
    Action("stop_all", "Stop every robot at once", Nothing, _OPERATOR, _stop_all),
    Action("create_user", "Make an account for a person", NewUser, _ADMINISTRATOR, _create_user, spends=True),
    Action("change_user", "Change roles or disable an account", ChangedUser, _ADMINISTRATOR, _change_user,
           spends=True),
    Action("set_passphrase", "Set a new passphrase", NewPassphrase, frozenset(), _set_passphrase),
    Action("issue_token", "A token for a program that acts in your name", NewToken, frozenset(),
           _issue_token),
    Action("revoke_token", "Make one of your tokens worthless", TokenId, frozenset(), _revoke_token),
)  # fmt: skip

ACTIONS: dict[str, Action] = {action.name: action for action in _TABLE}
assert len(ACTIONS) == len(_TABLE), "names of actions must be unique"
