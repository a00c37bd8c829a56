"""Post a cleaning on the bus and wait until it is paid: python post_and_wait.py SITE_FILE ITEM REQUEST_ID"""

import sys
from decimal import Decimal
from pathlib import Path

from rodeo.bus.session import Bus
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import ORGANIZATION, Participant
from rodeo.errors import RodeoError, TaskNotDone
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity


def main(site_file: str, item: str, request_id: str) -> int:
    site = Site.load(Path(site_file))
    with Bus.open(site.bus.router, timeout_s=10.0, identity=identity(site, OPERATOR)) as bus:
        organization = Participant(bus, site.org, ORGANIZATION)
        request = RegisterTask(
            request_id=request_id,  # the same again posts nothing twice
            kind="waste_disposal",
            reward_iec=Decimal(100),
            params={"item_id": item},
        )
        posted = organization.command("register_task", request)
        print(f"task {posted.task_id} is posted")
        try:
            task = organization.wait(posted.task_id)
        except TaskNotDone as error:
            print(f"{error.message}: {error.details['reason']}")
            return 1
        print(f"{task.executor_name} was paid {task.paid_iec} IEC; its proof is {task.proof_sha256}")
        print(f"{task.verdict}: {task.reason}")
    return 0 if task.verdict == "accepted" else 1  # who did not do it is paid as well, a tenth or nothing


if __name__ == "__main__":
    try:
        sys.exit(main(*sys.argv[1:4]))
    except RodeoError as error:
        sys.exit(f"{error.code}: {error}")
