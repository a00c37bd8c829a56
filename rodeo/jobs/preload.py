"""The last module that the fork server loads: what each verification would compute anew."""

import sys

from rodeo.checks.case import Checks
from rodeo.checks.rules import physics_version, sources_of
from rodeo.kinds import installed

for name, module in list(sys.modules.items()):
    if isinstance(getattr(module, "__dict__", {}).get("CHECKS"), Checks):
        sources_of(name)
installed()
physics_version()
