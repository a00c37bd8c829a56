"""Commands of people who do tasks themselves, and of those who judge them."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast, get_args

import typer

from rodeo.bus.messages import Fault, Ruling
from rodeo.bus.session import Bus
from rodeo.errors import InvalidRequest
from rodeo.judging.verdicts import verdict_words
from rodeo.person.photo_code import photo_code
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    KINDS,
    PARTICIPANTS,
    JsonOption,
    SiteOption,
    connected,
    print_json,
    reports_errors,
    say,
    send_command,
    site_clock,
    time_left,
)
from rodeo_cli.formatting import iec
from rodeo_cli.signing import SignOption, ValidOption, sign_into

if TYPE_CHECKING:
    from collections.abc import Callable

    from rodeo.bus.messages import Task
    from rodeo.commands import Command
    from rodeo.person.statement import Executor

AsOption = Annotated[
    str | None,
    typer.Option(
        "--as",
        help="The participant; by default the only one in the site file.",
        autocompletion=PARTICIPANTS,
    ),
]


@reports_errors
def offer(
    kind: Annotated[str, typer.Argument(help="The kind of task.", autocompletion=KINDS)],
    price: Annotated[str, typer.Option(help="Price in IEC.")],
    site: SiteOption = DEFAULT_SITE,
    participant: AsOption = None,
    description: Annotated[str, typer.Option(help="Description for people.")] = "",
) -> None:
    """Offer to do tasks of a kind: from then on they may be assigned to the participant.

    `rodeo service price`, `pause`, `resume` and `withdraw` change the offer.
    """
    from rodeo.kinds import kinds_of
    from rodeo.person import pace  # takes its time to import, as in _executor

    with connected(site) as (loaded, bus):
        name = _name(loaded, participant)
        request = {"kind": kind, "price_iec": price, "description": description}
        reply = send_command(loaded, bus, name, "register_service", **request)
    say(f"{name} offers {kind} for {iec(price)}: service {reply['service_id']}.")
    if (warning := pace.warning(loaded)) and kinds_of(loaded).by_people(kind):
        say(warning)


@reports_errors
def accept(
    task_id: int,
    site: SiteOption = DEFAULT_SITE,
    participant: AsOption = None,
    sign: SignOption = None,
    valid_s: ValidOption = 600,
) -> None:
    """Agree to a task that is assigned to a person, and begin it. This opens its sealed recording.

    From then on it costs the person's bond a penalty not to submit it. After --sign, run this command again
    without it once somebody has sent the file: it opens the recording.
    """
    from rodeo.dao import acceptance  # takes its time to import, as in _executor

    with connected(site) as (loaded, bus):
        if sign is not None:
            _sign_attempt(loaded, bus, _name(loaded, participant), acceptance, task_id, valid_s, sign)
            return
        task = _executor(loaded, bus, participant).accept(task_id)
        left = time_left(loaded, bus, task.execution_deadline or 0.0)
    say(f"You have begun task {task_id}: {task.description or task.kind}")
    say(f"It pays {iec(task.price_iec)} when an auditor accepts it.")
    say(f"Submit it in time: {left}.")
    say(f"Show this code in a photo: {photo_code(task.nonce or '')}")


@reports_errors
def abandon(
    task_id: int,
    site: SiteOption = DEFAULT_SITE,
    participant: AsOption = None,
    sign: SignOption = None,
    valid_s: ValidOption = 600,
) -> None:
    """Give back a task that is assigned to the participant. The next attempt goes to whoever waits.

    In the kind's grace period the attempt does not count, and a proven provider loses nothing. Others get no
    task for a while. Later it costs the penalty, if the task was accepted.
    """
    from rodeo.dao import Participant, abandonment  # take their time to import, as in _executor

    with connected(site) as (loaded, bus):
        name = _name(loaded, participant)
        if sign is not None:
            _sign_attempt(loaded, bus, name, abandonment, task_id, valid_s, sign)
            return
        executor = Participant(bus, loaded.org, name)
        executor.abandon_task(executor.task(task_id))
    say(f"{name} has given back task {task_id}.")


@reports_errors
def submit(
    task_id: int,
    note: Annotated[str, typer.Option(help="What was done, in words.")],
    photo: Annotated[
        list[Path] | None,
        typer.Option(exists=True, dir_okay=False, help="A JPEG or PNG picture; repeatable."),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: AsOption = None,
) -> None:
    """Submit a person's work: seal the note and photos, store them and put their hash on chain."""
    photos = [path.read_bytes() for path in photo or []]
    with connected(site) as (loaded, bus):
        sha256 = _executor(loaded, bus, participant).submit(task_id, note, photos)
    say(f"Your work on task {task_id} is submitted and waits for a verdict. Proof: {sha256}")


@reports_errors
def review(
    task_id: int,
    site: SiteOption = DEFAULT_SITE,
    participant: Annotated[str, typer.Option("--as", help="The auditor.")] = "organization",
    as_json: JsonOption = False,
) -> None:
    """Show a submitted statement: note, photos, metadata, and earlier uses of the same photos."""
    from rodeo.dao import Participant
    from rodeo.person.pace import running_out_s
    from rodeo.person.review import Reviewer

    with connected(site) as (loaded, bus):
        auditor = Participant(bus, loaded.org, participant)
        task = auditor.task(task_id)
        found = Reviewer(loaded, auditor).review(task)
        ends_s = running_out_s(task)
        left = None if ends_s is None else time_left(loaded, bus, ends_s)
    if as_json:
        print_json(found.model_dump())
        return
    say(f"“{found.note}”")
    for line in found.lines():
        say(line)
    say(f"It pays {iec(task.price_iec)} if accepted.")
    if left is not None:
        say(f"Judge it in time: {left}.")


@reports_errors
def judge(
    task_id: int,
    reason: Annotated[str, typer.Option(help="Why, in words.")],
    accepted: Annotated[bool | None, typer.Option("--accept/--reject", help="The ruling.")] = None,
    given_up: Annotated[
        bool,
        typer.Option(
            "--given-up",
            help="The ruling: the executor could not do it. It is not paid, and pays nothing.",
        ),
    ] = False,
    impossible: Annotated[
        bool,
        typer.Option(
            "--impossible",
            help="The ruling: nobody could do this task. It ends and pays a tenth of the price.",
        ),
    ] = False,
    void: Annotated[
        str | None,
        typer.Option(
            metavar="FAULT",
            help="The ruling: the task ends, nobody is paid or pays. Whose doing it was: nobody, creator, "
            "creators_witness (a device of the creator), other_witness (another device) or oracle.",
        ),
    ] = None,
    amount: Annotated[
        str | None, typer.Option(help="Payment for accepted work, in IEC; the agreed price by default.")
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: Annotated[str, typer.Option("--as", help="The auditor.")] = "organization",
) -> None:
    """Rule on a submitted proof as an auditor, if auditors judge this kind or the oracle passed the proof on.

    `rodeo task review` shows what is known of it.
    """
    from rodeo.dao import Participant  # takes its time to import, as in _executor
    from rodeo.person import statement

    given = {
        "accepted": accepted is True,
        "rejected": accepted is False,
        "given_up": given_up,
        "impossible": impossible,
        "void": void is not None,
    }
    if sum(given.values()) != 1:
        raise InvalidRequest("give one ruling: --accept, --reject, --given-up, --impossible or --void FAULT")
    ruling = cast(Ruling, next(name for name, is_given in given.items() if is_given))
    if void not in (None, *get_args(Fault)):
        raise InvalidRequest("--void takes whose doing it was", given=void, faults=list(get_args(Fault)))
    fault = cast(Fault, void or "nobody")
    with connected(site) as (loaded, bus):
        auditor = Participant(bus, loaded.org, participant)
        statement.judge(loaded, auditor, task_id, ruling, reason, _amount(amount), fault)
    say(f"Task {task_id} is {verdict_words(ruling, reason, participant, by_people=True, fault=fault)}")


def _amount(text: str | None) -> Decimal | None:
    if text is None:
        return None
    try:
        return Decimal(text)
    except InvalidOperation:
        raise InvalidRequest("--amount is not an amount", amount=text) from None


def _sign_attempt(
    site: Site,
    bus: Bus,
    name: str,
    command: Callable[[Task], Command],
    task_id: int,
    valid_s: int,
    file: Path,
) -> None:
    """Have the executor's wallet sign it for the attempt that runs."""
    from rodeo.dao import Participant

    wanted = command(Participant(bus, site.org, name).task(task_id))
    request = wanted.model_dump(mode="json", exclude_defaults=True, exclude={"request_id"})
    sign_into(site, bus, name, wanted.declared.name, request, valid_s, file)


def _name(site: Site, participant: str | None) -> str:
    if participant is not None:
        return participant
    names = [one.name for one in site.participants]
    if len(names) != 1:
        raise InvalidRequest("choose one with --as NAME", participants=names)
    return names[0]


def _executor(site: Site, bus: Bus, participant: str | None) -> Executor:
    # Signing and sealing take their time to import; the other commands should not wait for them.
    from rodeo.dao import Participant
    from rodeo.person.statement import Executor
    from rodeo.signing import keystores

    name = _name(site, participant)
    key = keystores.open_key(site, name)
    return Executor(site, Participant(bus, site.org, name), key, site_clock(site, bus))
