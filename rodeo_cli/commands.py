"""The commands of `rodeo`."""

import typer

from rodeo_cli import (
    accounts,
    bins,
    classify,
    demo,
    disputes,
    experiment,
    forms,
    kinds,
    organization,
    people,
    report,
    robot,
    services,
    site,
    sites,
    tasks,
    verify,
)

app = typer.Typer(
    name="rodeo",
    help="Robots join an organization, do physical work, prove it and get paid.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    site.up,
    site.down,
    site.status,
    demo.demo,
    services.wallet,
    report.report,
    verify.verify,
    classify.classify,
):
    app.command()(command)
tasks.tasks.command()(people.accept)
tasks.tasks.command()(people.abandon)
tasks.tasks.command()(people.submit)
tasks.tasks.command()(people.review)
tasks.tasks.command()(people.judge)
services.services.command()(people.offer)
tasks.tasks.add_typer(disputes.disputes, name="dispute", cls=forms.group("task dispute"))
app.add_typer(tasks.tasks, name="task", cls=forms.group("task"))
app.add_typer(services.services, name="service", cls=forms.group("service"))
app.add_typer(organization.organization, name="organization")
app.add_typer(robot.robots, name="robot")
app.add_typer(bins.bins, name="bin")
app.add_typer(accounts.accounts, name="console")
app.add_typer(sites.sites, name="site")
app.add_typer(kinds.kinds, name="kind")
app.add_typer(experiment.experiments, name="experiment")
