"""Sell a robot energy at a dock, and prove what both sides signed."""

from decimal import Decimal

from rodeo.charging.orders import ChargingParams
from rodeo.kinds import Kind, Recorded
from rodeo.site.topics import BATTERY_STATE, DOCK_OUTPUT, WITNESS_STATEMENT
from rodeo_kinds.battery_charging.problems import complete, problems

KIND = Kind(
    name="battery_charging",
    title="Battery charging",
    description="A dock charges a robot's battery. The robot pays for the energy that both signed.",
    judge="oracle",
    params=ChargingParams,
    example={"robot": "panther1", "dock": "dock1", "soc_from": 0.2, "soc_target": 0.9, "energy_wh": 480.0},
    price_iec=Decimal(200),
    execution_window_s=4 * 3600,
    min_window_s=3600,
    grace_s=30 * 60,  # until then the robot has come to the dock, or the dock gives the charge back
    unit="charge",
    measure="kWh",
    provides="energy",
    recorded=(
        *map(Recorded, (DOCK_OUTPUT, BATTERY_STATE)),
        Recorded(WITNESS_STATEMENT, signed_by="meter"),
        Recorded(WITNESS_STATEMENT, signed_by="robot"),
    ),
    checks="rodeo_kinds.battery_charging.checks:CHECKS",
    harness="rodeo_kinds.battery_charging.harness:HARNESS",
    problems=problems,
    complete=complete,
)
