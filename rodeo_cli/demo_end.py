"""The end of `rodeo demo`: the two tasks, the balances, and how to look at the recordings."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from rodeo.site.config import Site
from rodeo_cli.common import console, print_table, say
from rodeo_cli.formatting import iec
from rodeo_cli.layout import Row


def command(*words: str | Path) -> str:
    """A `rodeo` command on a site, as it can be pasted into this shell: the last word is the site file."""
    *first, site = map(str, words)
    return shlex.join([*_rodeo(), *first, "--site", site])


def _rodeo() -> list[str]:
    """The words by which this shell calls the running command line."""
    script = Path(sys.argv[0])
    if script.name == "rodeo":
        found = shutil.which("rodeo")
        same = found is not None and Path(found).resolve() == script.resolve()
        return ["rodeo"] if same else [str(script)]
    return [sys.executable, "-m", "rodeo_cli"]


def recording(summary: dict[str, Any]) -> Path:
    """The first task's proof, as a path from here where it lies below."""
    path = Path(unquote(urlsplit(summary["tasks"][0]["proof_uri"]).path))
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def print_end(site: Site, path: Path, summary: dict[str, Any], link: str | None) -> None:
    """In three lines: what was done, what was proven, how to look at it. With the `link` into the console of
    a site that keeps running, also what to try there."""
    work, charge = summary["tasks"]
    supply = iec(str(summary["supply_iec"]["after"]))
    file = recording(summary)
    _tell("")
    _tell(
        f"[bold]Done:[/] {work['executor']} has cleaned for {iec(str(work['paid_iec']))}, and has bought a "
        f"charge for {iec(str(charge['paid_iec']))}."
    )
    _tell(
        "[bold]Proven:[/] an oracle has checked both sealed recordings, and only then the contracts paid. "
        f"All wallets hold {supply} as before."
    )
    if link is None:
        _tell(
            "[bold]Look:[/] check the recording of the cleaning yourself, as below, or run the demo "
            "with --keep and log in to its web page."
        )
        say(f"  {command('verify', file, path)}")
        return
    _tell(
        "[bold]Look:[/] the site keeps running, and this link logs you in to its web page, once, within an "
        "hour:"
    )
    say(link)
    _tell("")
    _tell("The sealed recording of the cleaning, and a command that checks it:")
    say(f"  {file}")
    say(f"  {command('verify', file, path)}")
    _tell("Three commands to try; the last one stops the site:")
    create = ("task", "create", work["kind"], *another_task(site), "--reward", f"{work['reward_iec']:g}")
    for words in (create, ("task", "list"), ("down",)):
        say(f"  {command(*words, path)}")


def another_task(site: Site) -> tuple[str, ...]:
    """Options of a task like the demo's, for another item of the lab."""
    assert site.demo is not None
    params = dict(site.demo.params)
    others = [item.id for item in site.items if item.id not in params.values()]
    if "item_id" in params and others:
        params["item_id"] = others[0]
    return tuple(
        word for name, value in params.items() for word in (f"--{name.replace('_', '-')}", str(value))
    )


def _tell(text: str) -> None:
    """A sentence with markup, folded between words on a terminal."""
    console.print(text, highlight=False)


def print_ledger(summary: dict[str, Any]) -> None:
    tasks = (
        Row(
            (
                f"{task['id']} {task['kind']}",
                f"{task['creator']} → {task['executor'] or 'nobody'}",
                task["state"],
                _span(task["assigned"], task["proof_submitted"]),
                _span(task["proof_submitted"], task["settled"]),
                f"{task['paid_iec']:g}",
            )
        )
        for task in summary["tasks"]
    )
    wallets = (
        Row((name, iec(str(before)), iec(str(after)), f"{after - before:+g} IEC"))
        for name, wallet in summary["wallets"].items()
        for before, after in [(wallet["before_iec"], wallet["after_iec"])]
    )
    console.print("\n[bold]tasks[/] (min:s of the site's clock, IEC)", highlight=False)
    print_table(("task", "from → to", "state", "work", "verdict", "paid"), tasks, folds=(0, 1))
    console.print("\n[bold]ledger[/]")
    print_table(("wallet", "before", "after", "change"), wallets)


def _span(start_s: float | None, end_s: float | None) -> str:
    if start_s is None or end_s is None:
        return ""
    minutes, seconds = divmod(round(end_s - start_s), 60)
    return f"{minutes}:{seconds:02d}"
