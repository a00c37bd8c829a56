"""How far from the place that a task names its item may lie: one limit for robot and oracle, in that order.

Whoever carries an item must not find out afterwards that it lay too far off. So the oracle allows more than
the robot takes, by several times what the robot's eyes and motion capture may disagree.
"""

PLACE_LIMIT_M = 0.30
"""What the creator of a task promises: somebody saw the item there, to about a foot's length."""
TAKEN_LIMIT_M = PLACE_LIMIT_M + 0.01
"""Where the robot sees an item that it takes; its eyes are right to a centimetre."""
JUDGED_LIMIT_M = PLACE_LIMIT_M + 0.05
"""Where motion capture signed that an item lay that is paid for."""
