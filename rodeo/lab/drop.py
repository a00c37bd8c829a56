"""What robot and oracle make of a drop, both of them the same.

How long a cleaning is recorded after the bin felt the drop: one time for robot and oracle, in that order.

Whoever did the work must not find out afterwards that its recording ended too soon. So the robot records for
longer than the oracle asks for, by what the last statement of motion capture may be older than the end.
"""

JUDGED_AFTER_DROP_S = 10.0
"""So long after the bin felt it, recording and statements of motion capture go on: nobody takes it out again
at once."""
RECORDED_AFTER_DROP_S = JUDGED_AFTER_DROP_S + 5.0
"""So long the robot records. Motion capture states something every 2 s while nothing moves, one statement may
be lost, and its clock may be off the bin's."""
WATCHED_S = JUDGED_AFTER_DROP_S + 4.0
"""So long after the drop the bin states whom it has heard: while the robot records, and late enough to miss
motion capture where that fell silent before it was seen that the item stays."""
SPEAKS_AGAIN_S = 300.0
"""Site time for which the robot records on where motion capture fell silent after the drop."""
SUBMITTED_S = 120.0
"""Before the end of the execution window it seals, uploads and submits all the same."""
WEIGHS_THE_SAME_N = 0.1
"""Two weights that one scale measures may be the same thing's if they differ by no more than this: each
settles to 0.05 N. The lightest item weighs 0.2 N."""
