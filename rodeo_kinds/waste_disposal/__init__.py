"""Carry an item from the floor to the smart bin, which says where it belongs."""

from decimal import Decimal

from rodeo.kinds import Kind, Recorded
from rodeo.site.topics import BIN_IMAGE, BIN_LOAD, DOCK_OUTPUT, ITEM_POSE, ROBOT_STATE, WITNESS_STATEMENT
from rodeo_kinds.waste_disposal.params import CleaningParams, complete, doubt, problems

KIND = Kind(
    name="waste_disposal",
    title="Waste disposal",
    description="A robot carries an item from the floor to the bin. The bin chooses the compartment.",
    judge="oracle",
    params=CleaningParams,
    example={"item_id": "item1", "x_m": 4.6, "y_m": 1.2},
    price_iec=Decimal(100),
    execution_window_s=2 * 3600,  # long enough for a robot that must charge before it can do the work
    recorded=(
        *map(Recorded, (*ROBOT_STATE, ITEM_POSE, BIN_LOAD, DOCK_OUTPUT, BIN_IMAGE)),
        Recorded(WITNESS_STATEMENT, signed_by="mocap"),
        Recorded(WITNESS_STATEMENT, signed_by="bin"),
        Recorded(WITNESS_STATEMENT, signed_by="robot"),
    ),
    behaviour="rodeo_kinds.waste_disposal.behaviour:WasteDisposal",
    checks="rodeo_kinds.waste_disposal.checks:CHECKS",
    harness="rodeo_kinds.waste_disposal.harness:HARNESS",
    problems=problems,
    complete=complete,
    subject="item_id",
    doubt=doubt,
)
