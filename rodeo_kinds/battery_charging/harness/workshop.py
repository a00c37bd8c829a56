"""What a forger of charges works with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo_kinds.battery_charging.harness.film import KIND, charging_chain_record, film_charging
from rodeo_testing.assignments import CHARGE_BINDING, METER
from rodeo_testing.harness import Harness
from rodeo_testing.recordings import Sides, Take, Witnesses
from rodeo_testing.workshop import Registered, Submission, Workshop, with_devices

OUTPUT, GAUGE = "dock1/output", "panther1/battery_state"


class ChargingWorkshop(Workshop):
    """A robot charges from 86 % on."""

    kind = KIND

    binding = CHARGE_BINDING
    device = METER

    def film(self) -> Take:
        return film_charging(self.site, soc=0.86)

    def chain_record(self, **task: Any) -> ChainRecord:
        return charging_chain_record(self.take, **task)

    def charged(
        self,
        take: Take,
        *,
        device: LocalAccount | None = None,
        sides: Sides | None = None,
        forks: Callable[[float], bool] = lambda time_s: False,
        twin: Callable[[float], bool] = lambda time_s: False,
        devices: Registered = lambda device: device,
        **task: Any,
    ) -> Submission:
        """`take` as proof of the charge, sealed with the meter's key. `forks` is when the robot hears heads
        of another version of it, `twin` when heads of another recording, too; `devices` may change the
        registry."""
        chain_record = with_devices(self.chain_record(**task), devices)
        witnesses = Witnesses(charge=sides or Sides(), forks=forks, twin=twin)
        return Submission(chain_record, self.sealed(take, None, device, witnesses))


HARNESS = Harness(ChargingWorkshop)


@HARNESS.honest
def a_charge_that_both_sign(shop: ChargingWorkshop) -> Submission:
    """A dock charges a robot to its target, and both sign for each step."""
    return shop.submitted(shop.take)
