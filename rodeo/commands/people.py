"""Roles of people who may give commands in the console, and for which wallet."""

from rodeo.commands.declare import Console

PEOPLE = ("console", "operator")
"""Processes that speak for people."""

BY_OPERATOR = Console(("operator",))
BY_TREASURER = Console(("treasurer",))
BY_ADMINISTRATOR = Console(("administrator",))
FOR_GOOD = Console(("administrator",), for_good={})
_PROVIDER = ("operator", "executor", "administrator")
"""Roles that speak for a wallet: the organization's or their own."""
BY_PROVIDER = Console(_PROVIDER, "provider")
BY_ANYBODY = Console(_PROVIDER, "anybody")
BY_MEMBER = Console(("executor",), "member")
BY_PROPOSER = Console(("executor", "administrator"), "proposer")
