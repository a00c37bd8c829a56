"""The interface for programs: the pages' actions and questions, with a token instead of a login."""

# No postponed annotations: FastAPI reads those of functions that are made inside functions.

from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

from fastapi import Body, Depends, FastAPI, Header, Query, Request, Security
from fastapi import Path as PathParameter
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from fastapi.sse import EventSourceResponse
from pydantic import BaseModel, ConfigDict, Field

from rodeo.access.accounts import User
from rodeo.access.errors import NotLoggedIn
from rodeo.bus.messages import DaoEvent, Kind, Task, TaskState
from rodeo.bus.queries import QUERIES, TASKS, Tasks
from rodeo.checks.report import Report
from rodeo.display.story import Step
from rodeo.errors import RequestError, RodeoError
from rodeo.evidence.errors import EvidenceError
from rodeo.host.http import answer_with_problems, problem, problems
from rodeo.text.pydantic_words import wrong_fields
from rodeo.text.strict_json import Json
from services.console import events as event_streams
from services.console.actions import ACTIONS, ORGANIZATION, Action
from services.console.attempts import Attempt
from services.console.attempts import attempts as attempts_of
from services.console.heartbeats import ProcessState
from services.console.pages.frame import Console

TaskId = Annotated[int, PathParameter(ge=0, lt=2**63)]
AttemptNumber = Annotated[int | None, Query(ge=1, lt=2**8, description="By default the last one")]


class Lab(BaseModel):
    """Where everything is."""

    lab: Json
    """What stands there."""
    now: Json
    """Where robots and items were last seen, m and rad in the frame map."""


class Scraped(BaseModel):
    """Targets of Prometheus."""

    targets: list[str]
    labels: dict[str, str]


class Done(BaseModel):
    """What an action did. Of a command on chain: its transaction, and the number of what it made; with
    `dry_run` its calls and their cost."""

    model_config = ConfigDict(extra="allow")

    tx_hash: str | None = None
    block: int | None = None
    task_id: int | None = None
    """Number of a new task."""
    warning: str | None = None
    """Why a new task can probably not be done."""


_CODES = {
    401: "not_logged_in",
    403: "forbidden",
    404: "config_error unknown_task unknown_service unknown_account unknown_file unknown_query",
    409: "account_exists robot_unavailable insufficient_funds request_id_reused unknown_event_id",
    422: "invalid_event_id invalid_request weak_passphrase",
    429: "too_many_streams",
    502: "malformed_answer",
    503: "bridge_not_ready bus_unavailable no_responder",
    504: "query_timeout",
}
_STATUS_BY_CODE = {code: status for status, codes in _CODES.items() for code in codes.split()}

_PROBLEMS = problems(
    {
        400: "The request cannot be read",
        401: "The token is missing or revoked",
        403: "The token's owner has no role that allows this",
        404: "There is no such thing",
        409: "The organization refuses this in its present state",
        413: "The request is too large",
        422: "A field is wrong",
        429: "The address sends too many requests, or the account reads too many streams",
        503: "The bridge does not answer; try again later",
        504: "No answer in time; check whether it happened before you try again",
    }
)


def make_api(console: Console) -> FastAPI:
    """The application under /api; its description is /api/openapi.json."""
    api = FastAPI(
        title="RODEO console",
        summary="Tasks, services, money and robots of an organization.",
        version="1",
        docs_url=None,
        redoc_url=None,
        responses=_PROBLEMS,
    )
    bearer = HTTPBearer(auto_error=False, description="A token from the page Accounts")

    def caller(credentials: Annotated[HTTPAuthorizationCredentials | None, Security(bearer)]) -> User:
        if credentials is None:
            raise NotLoggedIn("send a token: Authorization: Bearer ...")
        return console.accounts.token_user(credentials.credentials)

    Caller = Annotated[User, Depends(caller)]  # noqa: N806 - a type

    answer_with_problems(api, status_of)

    @api.exception_handler(RequestValidationError)
    async def refuse_fields(_request: Request, error: RequestValidationError) -> Response:
        return problem(422, "invalid_request", "a field is wrong", {"fields": wrong_fields(error.errors())})

    _questions_about_tasks(api, console, Caller)
    _questions_about_the_site(api, console, Caller)
    _stream_of_events(api, console, bearer, Caller)
    for action in ACTIONS.values():
        _offer(api, console, action, Caller)
    return api


def _questions_about_tasks(api: FastAPI, console: Console, caller: Any) -> None:
    queries = console.queries

    @api.get("/tasks")
    def tasks(
        _user: caller,
        state: TaskState | None = None,
        kind: Kind | None = None,
        text: Annotated[
            str | None, Query(max_length=200, description="Text to find in the description or parameters")
        ] = None,
        limit: Annotated[int, Field(ge=1, le=500)] = 50,
        offset: Annotated[int, Field(ge=0, lt=2**63)] = 0,
    ) -> Tasks:
        """One page of tasks, newest first."""
        return queries.ask(TASKS, limit=limit, offset=offset, state=state, kind=kind, text=text)

    @api.get("/tasks/{task_id}")
    def task(task_id: TaskId, _user: caller) -> Task:
        """One task."""
        return queries.task(task_id)

    @api.get("/tasks/{task_id}/attempts")
    def attempts(task_id: TaskId, _user: caller) -> list[Attempt]:
        """Each attempt: its executor, its proof, and what was said of it."""
        return attempts_of(queries.history(queries.task(task_id).id))

    @api.get("/tasks/{task_id}/dispute")
    def dispute(task_id: TaskId, _user: caller) -> list[Step]:
        """The story of its dispute: rulings, votes, challenges, and who got what of the stakes."""
        return queries.story(queries.history(queries.task(task_id).id))

    @api.get("/tasks/{task_id}/report", responses={200: {"model": Report | Json}})
    def report(task_id: TaskId, _user: caller, attempt: AttemptNumber = None) -> Json:
        """The oracle's report on its proof, check by check."""
        return queries.report(queries.evidence(task_id, attempt))

    @api.get(
        "/tasks/{task_id}/proof",
        response_class=FileResponse,
        responses={200: {"content": {"application/octet-stream": {}}, "description": "The recording (MCAP)"}},
    )
    def proof(copy: Annotated[Path, Depends(_copy_of_proof(console, caller))]) -> FileResponse:
        """Its proof, a sealed recording."""
        return FileResponse(copy, filename=copy.name, media_type="application/octet-stream")


def _stream_of_events(api: FastAPI, console: Console, bearer: HTTPBearer, caller: Any) -> None:
    streams = event_streams.Streams(console)

    async def place(
        user: caller,
        last_event_id: Annotated[
            str | None,
            Header(description="The id of the last event that you have read: the stream continues after it"),
        ] = None,
        after: Annotated[
            int | None,
            Query(
                ge=0,
                lt=2**63,
                description="Begin after the event with this `seq`; 0 for the first one. By default only "
                "new events are sent",
            ),
        ] = None,
    ) -> AsyncIterator[event_streams.Place]:
        with streams.admitted(user.name):
            yield await streams.start(last_event_id, after)

    @api.get("/events", response_class=EventSourceResponse)
    async def events(
        start: Annotated[event_streams.Place, Depends(place)],
        credentials: Annotated[HTTPAuthorizationCredentials, Security(bearer)],
        name: Annotated[
            str | None,
            Query(
                pattern=r"^[A-Za-z]+(,[A-Za-z]+)*$",
                max_length=500,
                description="Names of events, separated by commas; by default all",
            ),
        ] = None,
        task_id: Annotated[int | None, Query(ge=0, lt=2**63, description="Of this task only")] = None,
    ) -> AsyncIterator[DaoEvent]:
        """The contracts' events as they happen, as server-sent events.

        The stream ends after some minutes. Read it again with the id of the last event in `Last-Event-ID`:
        then you miss no event and get none twice. `EventUndone` says that a reorganization took one back."""
        names = set(name.split(",")) if name else None

        def is_wanted(event: DaoEvent) -> bool:
            return (names is None or event.name in names) and task_id in (None, event.task_id)

        def allowed() -> User:
            return console.accounts.token_user(credentials.credentials)

        async for one in streams.follow(start, is_wanted, allowed):
            yield one  # type: ignore[misc]  # what FastAPI sends of a DaoEvent


def _questions_about_the_site(api: FastAPI, console: Console, caller: Any) -> None:
    queries = console.queries

    @api.get("/processes")
    def processes(_user: caller) -> list[ProcessState]:
        """Every process of the site: its state and what it does."""
        return console.live.heartbeats.processes

    @api.get("/metrics-targets")
    def metrics_targets(_user: caller) -> list[Scraped]:
        """Where each process serves its metrics, as Prometheus asks for it (`http_sd_configs`)."""
        found = console.live.heartbeats.metrics
        return [Scraped(targets=[at], labels={"process": name}) for name, at in found.items()]

    @api.get("/lab", responses={200: {"model": Lab}})
    def lab(_user: caller) -> Json:
        """What stands in the lab (`lab`) and where robots and items were last seen (`now`; m, rad). What is
        not `fresh` is old: motion capture and robots are heard while somebody looks, or asks this every few
        seconds."""
        return {"lab": console.lab, "now": console.live.asked_map()}

    @api.get("/transfers", responses={200: {"model": QUERIES["transfers"].answer}})
    def transfers(
        _user: caller,
        account: Annotated[
            str, Query(max_length=64, description="A participant or an address")
        ] = ORGANIZATION,
        limit: Annotated[int, Field(ge=1, le=500)] = 50,
        offset: Annotated[int, Field(ge=0, lt=2**63)] = 0,
    ) -> Json:
        """One page of an account's transfers with the reason of each, newest first."""
        return queries.state("transfers", account=account, limit=limit, offset=offset)

    for name, summary in {
        "organization": "Its rules: kinds of work, who is chosen, bonds and penalties.",
        "participants": "Everybody who ever took part, with roles, balance and record.",
        "services": "Services on offer and their records.",
        "wallets": "Balances of the site's participants.",
        "devices": "Keys that may sign evidence.",
        "roots": "Daily roots on chain: the hash of what a device signed on a day.",
        "chain": "The chain, its contracts and the kinds of work that are accepted.",
    }.items():
        answer: dict[int | str, Any] = {200: {"model": QUERIES[name].answer}}
        api.get(f"/{name}", name=name, description=summary, responses=answer)(_state(console, name, caller))


def _state(console: Console, what: str, caller: Any) -> Callable[..., Json]:
    def state(_user: caller) -> Json:
        return console.queries.state(what)

    return state


def _copy_of_proof(console: Console, caller: Any) -> Callable[..., Iterator[Path]]:
    def copy(task_id: TaskId, _user: caller, attempt: AttemptNumber = None) -> Iterator[Path]:
        with console.queries.proof(console.queries.evidence(task_id, attempt)) as path:
            yield path

    return copy


def _offer(api: FastAPI, console: Console, action: Action, caller: Any) -> None:
    """POST /actions/<name> with the action's model as its body."""

    def perform(user: caller, request: Annotated[action.model, Body()]) -> Json:  # type: ignore[name-defined]
        return console.actions.perform(user, action.name, request)

    roles = " or ".join(sorted(action.roles)) or "none"
    api.post(
        f"/actions/{action.name.replace('_', '-')}",
        name=action.name,
        summary=action.summary,
        description=f"Needs the role: {roles}.",
        tags=["actions"],
        responses={200: {"model": Done}},
    )(perform)


def status_of(error: RodeoError) -> int:
    """The HTTP status that tells a program what kind of error this is."""
    if isinstance(error, EvidenceError):
        return 404
    # What the bridge or a contract refused: the request was understood, the organization says no.
    return _STATUS_BY_CODE.get(error.code, 400 if isinstance(error, RequestError) else 409)
