"""`python -m services.ros_dao --site FILE [--owner NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.processes import ros_process
from services.ros_dao.process import run

DESCRIPTION = "The organization as ROS 2 services, for the nodes of one owner's participants."

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            "ros_dao", "owner", lambda site: [one.owner for one in site.ros], ros_process, run, DESCRIPTION
        )
    )
