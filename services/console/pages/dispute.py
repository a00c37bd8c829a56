"""A task's dispute: whether the person may challenge the ruling, at what price, and what happened so far."""

from __future__ import annotations

from nicegui import ui

from rodeo.access.accounts import User
from rodeo.bus.messages import DaoEvent, Task
from rodeo.commands.judging import challenge_of
from rodeo.display.formatting import iec
from rodeo.display.story import Step
from rodeo.errors import RodeoError
from rodeo.judging.rulings import can_only_lose
from services.console.actions import speaks_for
from services.console.pages import frame, widgets
from services.console.pages.frame import Console


def draw_button(console: Console, task: Task) -> None:
    """Nothing for a person who may not challenge the ruling; the reason where that can only lose."""
    challenger = challenger_of(console, task, frame.user())
    if challenger is None or task.standing is None or task.price_iec is None:
        return
    of_creator, of_executor = challenger == task.creator_name, challenger == task.executor_name
    if why := can_only_lose(task.standing, task.price_iec, of_creator, of_executor):
        widgets.Text("span", f"No challenge by {challenger}: {why}", "soft")
        return
    ui.button("Challenge", on_click=lambda: _challenge(console, task, challenger)).props("outline")


def challenger_of(console: Console, task: Task, user: User) -> str | None:
    """The party to the task, or the judge of challenges, that this person speaks for, if the ruling can be
    challenged now. A party may take over what a judge has challenged."""
    if task.standing is None or task.dispute is None or task.dispute.challenge_iec is None:
        return None
    challenger, parties = task.dispute.challenger, (task.creator_name, task.executor_name)
    # The organization's own key challenges in its name.
    if challenger is not None and console.live.summary.names.get(challenger) in parties:
        return None
    disputes = console.site.disputes
    instances = [] if disputes is None else disputes.instances
    judges = [name for one in instances for name in one.judges] if challenger is None else []
    able = (one for one in (*parties, *judges) if one is not None)
    return next((one for one in able if speaks_for(user, one)), None)


@widgets.on_page
async def _challenge(console: Console, task: Task, participant: str) -> None:
    async def perform(answer: dict[str, str]) -> bool:
        request = {"participant": participant, "task_id": task.id, **answer, **agreed}
        done = f"The ruling on task {task.id} is challenged"
        return await frame.act(console, "challenge", request, done) is not None

    agreed = challenge_of(task) or {}
    stake = iec(agreed["stake_iec"])
    await widgets.ask_form(
        f"Challenge the ruling on task {task.id}? {participant} loses {stake} if it is right",
        {"reason": widgets.Field("Why it is wrong")},
        f"Challenge with {stake}",
        perform,
    )


async def story_of(console: Console, events: list[DaoEvent]) -> list[Step] | str:
    """What happened, or why that is not known now; nothing where nobody has challenged a ruling."""
    if not any(event.name == "Challenged" for event in events):
        return []
    try:
        return await frame.ask(console.queries.story, events)
    except RodeoError as error:
        return error.message


def draw_story(story: list[Step] | str) -> None:
    if isinstance(story, str):
        widgets.Text("p", f"The story of the dispute is not known now: {story}", "soft")
    elif story:
        widgets.Text("h3", "Dispute")
        with ui.element("ol").props('aria-label="Story of the dispute"'):
            for step in story:
                widgets.Text("li", f"{frame.when(step.time_s)}: {step.text}", "wrap")
