"""What the fork server loads before the first proof comes: the bin's network, which takes half a second."""

from services.oracle.checks.picture import network

network()
