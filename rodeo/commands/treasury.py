"""Commands about money: pay, collect, deposit, and what may be taken out of the treasury."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from eth_utils import to_checksum_address
from pydantic import Field, model_validator

from rodeo.bus.messages import Address, Iec, Party, Payment
from rodeo.chain.contracts.types import Role
from rodeo.commands.declare import Command, Line, command
from rodeo.commands.people import BY_ADMINISTRATOR, BY_TREASURER
from rodeo.display.formatting import span

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.commands.desk import Desk


def _budget_in_words(said: Mapping[str, Any]) -> str:
    limited = f"at most {said['amount_iec']} IEC in {span(said['period_s'])}"
    limit = limited if said["period_s"] else "as much as there is"
    return f"The role {said['role']} may take {limit} out of the treasury."


@command("ros_dao")
class Transfer(Command):
    """Pay from the wallet to another account."""

    to: Party = Field(examples=["panther1"])
    amount_iec: Payment = Field(examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        amount = desk.currency.to_units(self.amount_iec)
        to = desk.names.address(self.to)
        desk.require_funds(desk.address, amount)
        return [desk.calls.transfer(to, amount)]

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.amount_iec)


@command("ros_dao")
class Collect(Command):
    """Collect payments to the wallet that the token refused before."""

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.calls.withdraw_payments(desk.address)]


@command(
    line=Line("organization deposit {amount_iec}", "{participant} paid {amount_iec} IEC into the treasury."),
    console=BY_TREASURER,
)
class Deposit(Command):
    """Pay into the treasury from the account that signs."""

    amount_iec: Payment = Field(description="In IEC.", examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        amount = desk.currency.to_units(self.amount_iec)
        # From the key's own account also for the organization, whose contract is where it goes.
        desk.require_funds(desk.key_address, amount)
        approval = desk.approval(desk.client.organization, amount)
        return [*approval, desk.client.organization_calls.deposit(amount)]

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.amount_iec)


@command(
    line=Line("organization withdraw {amount_iec}", "The treasury paid {amount_iec} IEC to {to}."),
    console=BY_TREASURER,
)
class Withdraw(Command):
    """Pay out of the treasury."""

    to: Party = Field(description="A participant's name or an address.", examples=["panther1"])
    amount_iec: Payment = Field(description="In IEC.", examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        amount = desk.currency.to_units(self.amount_iec)
        to = desk.names.address(self.to)
        desk.require_funds(desk.client.organization, amount)
        return [desk.client.organization_calls.transfer(to, amount)]

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.amount_iec)


@command(
    line=Line(
        "organization budget {role} {amount_iec}",
        _budget_in_words,
        defaults={"amount_iec": "0", "period_s": 86400},
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SetBudget(Command):
    """Limit what all holders of a role together take out of the treasury.

    The first period begins now."""

    role: Literal["operator", "treasurer"] = Field(
        description="operator: rewards and bonds; treasurer: withdrawals.", examples=["treasurer"]
    )
    amount_iec: Iec = Field(Decimal(0), description="In IEC, for each period.", examples=["100"])
    period_s: Annotated[int, Field(ge=0, lt=2**24)] = Field(
        0, description="In seconds. 0 ends the limit.", examples=[86400]
    )

    @model_validator(mode="after")
    def _amount_has_a_period(self) -> Self:
        if self.amount_iec and not self.period_s:
            raise ValueError("an amount needs a period: a period of 0 ends the limit")
        return self

    def calls(self, desk: Desk) -> list[Call]:
        role = Role[self.role.upper()]
        amount = desk.currency.to_units(self.amount_iec)
        return [desk.client.organization_calls.set_budget(role, amount, self.period_s)]


@command(
    line=Line("organization rescue {token}", "Tokens of {token} were sent on to {to}."),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class RescueTokens(Command):
    """Send on tokens that somebody sent to the contracts by mistake. Escrow and treasury stay as they are."""

    token: Address = Field(
        description="Address of the ERC-20 contract that the tokens are of.",
        examples=["0x5FbDB2315678afecb367f032d93F642f64180aa3"],
    )
    to: Party = Field(description="A participant's name or an address.", examples=["panther1"])

    def calls(self, desk: Desk) -> list[Call]:
        to = desk.names.address(self.to)
        return [desk.client.organization_calls.rescue_tokens(to_checksum_address(self.token), to)]

    def spends(self, desk: Desk) -> int:
        ours = to_checksum_address(self.token) == desk.client.deployment.address("IECoin")
        return desk.client.tasks.unaccounted() if ours else 0
