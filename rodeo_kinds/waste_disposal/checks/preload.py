"""What the fork server loads before the first proof comes: the installed network, which takes half a second.

It does not run the network: OpenCV's threads would be missing in every process that is forked from it.
A network that cannot be loaded must not end the fork server, which other kinds' proofs need, too: the check
that asks for it says so.
"""

import logging

from rodeo.errors import RodeoError
from rodeo.vision.classification import model_sha256
from rodeo_kinds.waste_disposal.checks.picture import network

try:
    network(model_sha256())
except (RodeoError, OSError) as error:
    logging.getLogger(__name__).error("the installed network cannot be loaded: %s", error)
