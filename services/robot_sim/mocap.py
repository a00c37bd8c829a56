"""The lab's motion capture: publishes the poses of bodies and signs what it published.

It works without its key (a simulator needs no organization); then poses go out that nobody vouches for.
"""

from __future__ import annotations

import logging

from eth_account.signers.local import LocalAccount

from rodeo import topics, wallets
from rodeo.bus import Bus
from rodeo.config import Site
from rodeo.errors import KeystoreMissing
from rodeo.evidence import attest
from rodeo.mocap import MocapStatement, PoseChain
from rodeo.ros2 import Publisher

log = logging.getLogger(__name__)

DEVICE = "mocap-device"


class MotionCapture:
    """The device: one key for all bodies."""

    def __init__(self, bus: Bus, site: Site) -> None:
        self._bus = bus
        self._site = site
        self._account: LocalAccount | None = None
        self._said = False

    def track(self, body: str, publisher: Publisher) -> TrackedBody:
        """Publish the poses of `body` through `publisher`."""
        return TrackedBody(self, body, publisher)

    def sign(self, statement: MocapStatement) -> None:
        """Publish `statement` under the device's key, as soon as there is one. Raises WalletError."""
        if self._account is None:
            try:
                self._account = wallets.load(self._site, DEVICE)
            except KeystoreMissing as error:
                if not self._said:
                    log.info("poses are not signed: %s", error)
                    self._said = True
                return
        key = topics.MOCAP_ATTESTATION.name(org=self._site.org, body=statement.body)
        self._bus.put_json(key, attest(statement.model_dump(), self._account))


class TrackedBody:
    """Poses of one body, published and chained. One thread at a time."""

    def __init__(self, device: MotionCapture, body: str, publisher: Publisher) -> None:
        self._device = device
        self._publisher = publisher
        self._chain = PoseChain(body)

    def publish_cdr(self, cdr: bytes, time_ns: int) -> None:
        """Send a geometry_msgs/PoseStamped, and the statement that it completes."""
        statement = self._chain.add(self._publisher.publish_cdr(cdr, time_ns), cdr, time_ns * 1e-9)
        if statement is not None:
            self._device.sign(statement)
