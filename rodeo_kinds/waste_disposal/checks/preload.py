"""What the fork server loads before the first proof comes: the bin's network, which takes half a second, and
what it is called by.

It does not run the network: OpenCV's threads would be missing in every process that is forked from it.
"""

from rodeo.vision.classification import model_sha256
from rodeo_kinds.waste_disposal.checks.picture import network

model_sha256()
network()
