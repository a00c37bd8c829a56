"""The lab's motion capture: publishes the poses of bodies and signs what it saw.

It works without its key (a simulator needs no organization); then its poses go out unsigned. `robot_sim` has
one where motion capture is simulated, else `services.mocap` has.
"""

from __future__ import annotations

import logging
from bisect import bisect_left
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rodeo.bus.session import Bus
from rodeo.dao import ORGANIZATION, Participant
from rodeo.errors import DiskFull, KeystoreMissing
from rodeo.signing import keystores
from rodeo.site.config import Site
from rodeo.site.providers import MOTION_CAPTURE as NAME
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.motion import MotionLog, Sample
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Motion
from rodeo.witness.witness import Witness

log = logging.getLogger(__name__)

_ASK_AGAIN_NS = 1_000_000_000
"""Site time between two looks for the keystore."""


class MotionCapture:
    """The device: one key and one chain for all bodies. One thread at a time.

    Args:
        folder: where it keeps what it signed.
        now_ns: the site's time.
        inputs: where its poses come from.
    """

    def __init__(
        self,
        bus: Bus,
        site: Site,
        folder: Path,
        bodies: Sequence[str],
        now_ns: Callable[[], int],
        inputs: Inputs = "sensor",
    ) -> None:
        self._bus = bus
        self._site = site
        self._folder = folder
        self._bodies = bodies
        self._now_ns = now_ns
        self._inputs = inputs
        self._witness: Witness | None = None
        self._roots: DailyRoots | None = None
        self._log: MotionLog | None = None
        self._poses_seen = np.full((len(bodies), 7), np.nan)
        """The last ones."""
        self._ask_ns = 0
        self._said = False
        self._full = False
        """The disk has no room for its statements."""

    def see(self, bodies: Sequence[str], poses: np.ndarray, seen: np.ndarray, time_ns: np.ndarray) -> None:
        """n bodies at k times (k,): their poses (k, n, 7), x, y, z in m, qx, qy, qz, qw; which of them are in
        view (k, n).

        Signs and publishes the statements that are due. Raises WalletError and BrokenJournal.
        """
        witness = self._witness or self._enroll(int(time_ns[-1]))
        chain = None if witness is None else witness.chain
        if witness is None or chain is None:
            return  # nobody knows yet for which organization it sees
        time_us = (time_ns // 1000).tolist()
        motion = self._log = self._log or MotionLog(self._bodies, time_us[0])
        first = 0
        while first < len(time_us):
            # Nothing is due before its time, so all until then is noted at once.
            end = max(bisect_left(time_us, motion.undue_until_us, first), first + 1)
            self._note(motion, bodies, poses[first:end], seen[first:end], time_us[first:end])
            now_us, first = time_us[end - 1], end
            if motion.due(now_us, heads=bool(witness.heads)):
                self._sign(motion, witness, chain, now_us)

    def _sign(self, motion: MotionLog, witness: Witness, chain: WitnessChain, now_us: int) -> None:
        try:
            attestation = chain.sign_next(
                Motion, now_us * 1e-6, lambda seq: motion.take(now_us, seq)._asdict()
            )
        except DiskFull as error:
            # The world continues. The missing statements are noticed later.
            if not self._full:
                log.error("motion capture publishes no statements: %s", error)
            self._full = True
            return
        self._full = False
        witness.publish(attestation)

    def _note(
        self,
        motion: MotionLog,
        bodies: Sequence[str],
        poses: np.ndarray,
        seen: np.ndarray,
        time_us: list[int],
    ) -> None:
        # Most bodies lie or stand where they were: to find that for all at once is several times cheaper.
        stays = (np.concatenate((self._poses_seen[None], poses[:-1])) == poses).all(axis=2) & seen
        self._poses_seen = poses[-1].copy()
        for number, stays_through in enumerate(stays.all(axis=0).tolist()):
            body = bodies[number]
            if stays_through and motion.stays(body, time_us[-1]):
                continue
            samples = [
                Sample(now_us, (x, y, z), (qw, qx, qy, qz))
                for now_us, in_view, (x, y, z, qx, qy, qz, qw) in zip(
                    time_us, seen[:, number].tolist(), poses[:, number].tolist(), strict=True
                )
                if in_view
            ]
            if samples:
                motion.add_all(body, samples)

    def missing(self) -> frozenset[str]:
        """Its name while it cannot sign yet; empty once it can."""
        witness = self._witness or self._enroll(self._ask_ns)
        return frozenset([NAME] if witness is None or witness.chain is None else [])

    def stall(self, from_ns: int, to_ns: int) -> None:
        """The lab stood still in this time, which goes into the next statement."""
        if self._log is not None:
            self._log.stall(from_ns // 1000, to_ns // 1000)

    def close(self) -> None:
        """Stop listening and answering."""
        if self._roots is not None:
            self._roots.close()
        if self._witness is not None:
            self._witness.close()

    def _enroll(self, time_ns: int) -> Witness | None:
        """Open the keystore, as soon as there is one."""
        if time_ns < self._ask_ns:
            return None
        self._ask_ns = time_ns + _ASK_AGAIN_NS
        try:
            account = keystores.open_key(self._site, f"{NAME}-device")
        except KeystoreMissing as error:
            if not self._said:
                log.info("cannot sign poses: %s", error)
                self._said = True
            return None
        witness = Witness(self._bus, self._site.org, NAME, account, self._folder, self._inputs, self._now_ns)
        organization = Participant(self._bus, self._site.org, ORGANIZATION)
        self._witness, self._roots = witness, DailyRoots(self._site, organization, witness)
        return witness
