"""`rodeo`: run a site and use its organization from a terminal."""

import typer

from rodeo.cli import classify, console, organization, robot, rules, site, sites, work

app = typer.Typer(
    name="rodeo",
    help="Robots join an organization, do physical work, prove it and get paid.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (site.up, site.down, site.status, organization.wallet, organization.verify, classify.classify):
    app.command()(command)
organization.tasks.command()(work.accept)
organization.tasks.command()(work.submit)
organization.tasks.command()(work.review)
organization.tasks.command()(work.judge)
organization.services.command()(work.offer)
app.add_typer(organization.tasks, name="task")
app.add_typer(organization.services, name="service")
app.add_typer(rules.rules, name="organization")
app.add_typer(robot.robots, name="robot")
app.add_typer(console.accounts, name="console")
app.add_typer(sites.sites, name="site")
