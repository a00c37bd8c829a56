"""The ROS 2 services of one participant: its commands, and all queries. What is refused is an answer, too."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh

from rodeo.bus.session import validate
from rodeo.commands import COMMANDS
from rodeo.dao import Participant
from rodeo.errors import InvalidRequest, RemoteError, RodeoError
from rodeo.interfaces.convert import message, problem, request_of
from rodeo.interfaces.package import KIND_SCHEMA, Asked, Command, KindSchema, asked, commands, parameter_model
from rodeo.kinds import Kinds
from rodeo.ros2 import types, wire
from rodeo.ros2.node import Node
from rodeo.ros2.service import DeferredService, PendingRequest, refuse
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.ros_names import ros_name
from rodeo.text.strict_json import encode
from services.ros_dao.workers import Busy, Workers

log = logging.getLogger(__name__)

COMMAND_THREADS, QUERY_THREADS = 64, 8
"""Threads for commands, each of which waits for its block, and threads for queries."""
Answer = Callable[[PendingRequest], dict[str, Any]]
"""Fields of the response."""


class UnknownInterface(RodeoError):
    """No service of this name and type is here."""

    machines = False


def _take(workers: Workers, typename: str, answer: Answer, pending: PendingRequest) -> None:
    """Have `pending` answered with a response of `typename`, or refuse it at once."""
    try:
        workers.submit(lambda: pending.respond(types.new(typename, **_answered(answer, pending))))
    except Busy as error:
        pending.respond(types.new(typename, problem=[problem(error)]))


def _answered(answer: Answer, pending: PendingRequest) -> dict[str, Any]:
    try:
        return answer(pending)
    except RodeoError as error:
        return {"problem": [problem(error)]}
    except Exception as error:
        log.exception("a request failed")
        return {"problem": [problem(RemoteError("internal", repr(error)))]}


class Services:
    """Serves `/<organization>/<participant>/...`."""

    def __init__(self, node: Node, site: Site, participant: Participant, kinds: Kinds) -> None:
        self._participant = participant
        self._kinds = kinds
        self._currency = site.economy.currency
        self._org = ros_name(site.org)
        self._commands = Workers(f"commands of {participant.name}", COMMAND_THREADS)
        self._queries = Workers(f"queries of {participant.name}", QUERY_THREADS)
        self._keys: set[str] = set()
        for service, command in commands().items():
            self._serve(
                node, service, command.interface.typename, self._commands, partial(self._command, command)
            )
        for service, query in asked().items():
            self._serve(node, service, query.interface.typename, self._queries, partial(self._query, query))
        # The name of the type and its hash are what follows the service's name.
        others = f"{node.domain_id}/{self._name('*')}/*/*"
        node.keep(Fallback(node.session, others, self._keys))

    def _name(self, service: str) -> str:
        named = ros_name(self._participant.name)
        return topics.ROS_SERVICE.name(org=self._org, participant=named, service=service)

    def _serve(self, node: Node, service: str, typename: str, workers: Workers, answer: Answer) -> None:
        name, response = self._name(service), f"{typename}_Response"
        types.prepare(f"{typename}_Request")
        types.prepare(response)
        self._keys.add(wire.data_key(node.domain_id, name, typename))
        node.keep(DeferredService(node, name, typename, partial(_take, workers, response, answer)))

    def _command(self, command: Command, pending: PendingRequest) -> dict[str, Any]:
        fields = request_of(command.request, pending.request, self._currency)
        # A request that names no ID has the client's number of it: the same request is carried out once.
        request = validate(COMMANDS[command.name], {"request_id": pending.request_id, **fields})
        if request.dry_run:
            return {"cost": encode(self._participant.cost(command.name, request)).decode()}
        return {"mined": [message(self._participant.command(command.name, request), self._currency)]}

    def _query(self, query: Asked, pending: PendingRequest) -> dict[str, Any]:
        fields = request_of(query.request, pending.request, self._currency)
        wanted = validate(parameter_model(query.query), fields).model_dump(exclude_unset=True)
        if query.query is KIND_SCHEMA:
            answer: Any = self._schema(wanted["kind"])
        else:
            answer = self._participant.ask(query.query, **wanted)
        return {"answer": [message(answer, self._currency)]}

    def _schema(self, kind: str) -> Any:
        if kind not in self._kinds:
            raise InvalidRequest(
                "this site lists no such kind", fields={"kind": f"one of {sorted(self._kinds)}"}
            )
        return KindSchema(parameters=self._kinds[kind].schema)

    def close(self) -> None:
        self._commands.close()
        self._queries.close()


class Fallback:
    """Answers requests for which there is no service with an error. To a client whose interfaces are of
    another version, the service would else be missing without a reason."""

    def __init__(self, session: zenoh.Session, expression: str, served: set[str]) -> None:
        self._served = served
        self._queryable = session.declare_queryable(expression, self._on_query, complete=True)

    def _on_query(self, query: zenoh.Query) -> None:
        if (key := str(query.key_expr)) in self._served:
            return
        name = key.rsplit("/", 2)[0]
        here = next((served for served in self._served if served.rsplit("/", 2)[0] == name), None)
        if here is None:
            refuse(query, UnknownInterface("there is no such service", asked=key))
        else:
            said = "this service has another type, or another version of it: build rodeo_msgs anew"
            refuse(query, UnknownInterface(said, asked=key, served=here))

    def close(self) -> None:
        self._queryable.undeclare()
