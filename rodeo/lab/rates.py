"""How often a robot publishes what it says of itself, as its site file declares it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

RATE_SHARE = 0.9
"""Share of the rate in the key table that is enough: a site's scheduler is not a metronome."""
TALKATIVE = 5
"""Times its declared rates that a robot may publish."""
FASTEST_HZ = 500.0
"""No topic of a device is recorded faster."""


class RatesConfig(BaseModel):
    """What the robot's drivers publish, Hz: at least what the table of keys says. A proof may hold five times
    as many messages, and a robot that publishes more takes no tasks."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    odom_hz: float = Field(50.0, ge=50, le=FASTEST_HZ)
    joint_states_hz: float = Field(50.0, ge=50, le=FASTEST_HZ)
    controllers_hz: float = Field(10.0, ge=10, le=FASTEST_HZ)
    """Arm and gripper, each."""
    battery_hz: float = Field(1.0, ge=1, le=FASTEST_HZ)
    pose_hz: float = Field(50.0, ge=50, le=FASTEST_HZ)
