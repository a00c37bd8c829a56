"""The bridge over a long run, on a site of its own: a hundred participants, and processes that are killed.

`soak_*`: 100 participants post and settle 1,000 tasks through one bridge on anvil. `soak_lost`,
`soak_doubled` and the like must be 0; `soak_memory_growth` is the bridge's resident memory at the end over
that after a quarter. What a task costs in the last quarter over what it cost in the second:
`soak_time_per_task_ratio` in wall time, `soak_cpu_per_task_ratio` in the bridge's own time and
`soak_node_cpu_per_task_ratio` in the node's, which do not tell how busy the machine was.
`faults_*`: bridge, node and router get SIGKILL at 50 random moments each in 100 tasks; `faults_unsettled`,
`faults_doubled`, `faults_index_differences` and the like must be 0. Progress goes to stderr; a run that takes
longer than its limit ends with SoakFailed and the last lines of each process's log.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

from tests.support.soak import faults, hundred_participants

KILLS, TASKS_WITH_KILLS = 50, 100


def run() -> dict[str, float]:
    """Minutes, on free ports, in folders that are removed."""
    return hundred_participants() | faults(TASKS_WITH_KILLS, KILLS)


def main(arguments: Sequence[str]) -> None:
    """`python -m bench.soak faults 100 50 anvil`: one of the two alone."""
    what, *numbers = arguments
    if what == "faults":
        tasks, kills, *backend = numbers
        print(json.dumps(faults(int(tasks), int(kills), backend[0] if backend else "eth-tester"), indent=2))
    else:
        print(json.dumps(hundred_participants(*map(int, numbers)), indent=2))


if __name__ == "__main__":
    main(sys.argv[1:])
