"""Commands about the keys that sign evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, StringConstraints

from rodeo.bus.messages import Address, DeviceName, Hex32, Party, Revocation, Signature
from rodeo.chain.contracts import abi
from rodeo.chain.contracts.types import halves, hex_bytes
from rodeo.commands.declare import Command, Line, command
from rodeo.commands.examples import ADDRESS, DIGEST, LOG_URI, SIGNATURE
from rodeo.commands.people import BY_ADMINISTRATOR, FOR_GOOD

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.commands.desk import Desk


@command(
    line=Line(
        "organization register-device {device}",
        "From now on {device} signs as {role} {name} of {owner}.",
        spelled={"device": "ADDRESS"},
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class RegisterDevice(Command):
    """Let a key sign evidence. If another key has this role and name, revoke that key first. Registered again
    with the same role and name, the key has another owner."""

    device: Address = Field(description="Address of the key that signs evidence.", examples=[ADDRESS])
    role: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")] = Field(
        description="What the device is: robot, bin, meter or mocap.", examples=["robot"]
    )
    owner: Party = Field(description="A participant's name or an address.", examples=["panther1"])
    name: DeviceName = Field(
        description="Its name on the site, for example panther1 or dock1.", examples=["panther1"]
    )
    signature: Signature = Field(
        description="The key's own signature: `sign-device` makes it.", examples=[SIGNATURE]
    )

    def calls(self, desk: Desk) -> list[Call]:
        owner = desk.names.address(self.owner)
        device = desk.names.address(self.device)
        calls = desk.client.organization_calls
        signed = halves(self.signature)
        return [calls.register_device(device, self.role, owner, self.name, *signed)]


@command(
    line=Line(
        "organization revoke-device {device}",
        "From now on the organization rejects what {device} signs.",
        spelled={"device": "ADDRESS"},
    ),
    console=FOR_GOOD,
    proposable=True,
)
class RevokeDevice(Command):
    """Reject everything that a key signs from now on. The reason decides about earlier signatures."""

    device: Address = Field(description="Address of the key that signs evidence.", examples=[ADDRESS])
    reason: Revocation = Field(
        description=(
            "superseded: another key takes over; compromised: somebody else may have signed with it."
        ),
        examples=["superseded"],
    )

    def calls(self, desk: Desk) -> list[Call]:
        reason = abi.Revocation[self.reason.upper()]
        return [desk.client.organization_calls.revoke_device(desk.names.address(self.device), reason)]


@command("charger", "itrash", "mocap", "robot_sim")
class PostRoot(Command):
    """Fix on chain what a device signed on a day, once per day. Only its owner and operators may send
    this."""

    device: Address = Field(examples=[ADDRESS])
    day: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        description="Days since 1970-01-01 UTC of site time; today or earlier.", examples=[20779]
    )
    root: Hex32 = Field(examples=[DIGEST])
    uri: str = Field(max_length=2048, description="URI of the device's log of that day.", examples=[LOG_URI])

    def calls(self, desk: Desk) -> list[Call]:
        device, root = desk.names.address(self.device), hex_bytes(self.root)
        return [desk.client.device_calls.post_root(device, self.day, root, self.uri)]
