"""Where chance comes from: one seed for the site, and from it a source for each use in each process.

`clock.seed` of the site file, the name of the process and what the draws are for are written as the JSON
text `[seed, "process", "purpose"]`, for example `[7, "robot_agent.panther1", "explore"]`. The SHA-256 of
that text, read as a whole number, seeds numpy's PCG64 (`numpy.random.default_rng`). So the same site draws
the same again, no two uses share their draws, and a further use or process changes nobody else's. Equal draws
need the same release of numpy: it keeps the streams of its bit generators, not those of its distributions
(NEP 19).

A process that is started again begins its draws from the start.

What must be unpredictable or unique is none of this: keys, passphrases, tokens, nonces, request and goal ids.
Neither is what a verdict rests on: the oracle's draws are the same on every site, so that anybody can repeat
them.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rodeo.site.config import Site

_UNSEEDED = 0
"""The seed of what is to be repeatable on a site that has none."""


def generator(site: Site, process: str, purpose: str, *, repeatable: bool = False) -> np.random.Generator:
    """The source of chance in `process` for `purpose`, for instance "explore".

    On a site without a seed it is another one each time, unless it has to be `repeatable`: what a simulated
    robot's sensors are like belongs to the robot, and must not change because its process was started again.
    """
    entropy = _entropy(site, process, purpose, repeatable)
    return np.random.default_rng(None if entropy is None else int.from_bytes(entropy))


class Moments:
    """A source for each moment of site time: what is drawn for one does not depend on what was drawn before.

    For sensors that are read when somebody asks, which depends on how busy the machine is. Repeatable on a
    site without a seed, too. The first 128 bits of the SHA-256 are the key of numpy's Philox, and the time is
    the highest word of its counter.
    """

    def __init__(self, site: Site, process: str, purpose: str) -> None:
        entropy = _entropy(site, process, purpose, repeatable=True)
        assert entropy is not None
        bits = np.random.Philox(key=np.frombuffer(entropy[:16], dtype="<u8").astype(np.uint64))
        self._source, self._beginning = np.random.Generator(bits), bits.state

    def at(self, time_ns: int) -> np.random.Generator:
        """The source of the moment `time_ns`, until the next call; asked for again, it begins anew."""
        # To wind one back takes a tenth of the time that a new one takes.
        self._beginning["state"]["counter"][3] = time_ns
        self._source.bit_generator.state = self._beginning
        return self._source


def _entropy(site: Site, process: str, purpose: str, repeatable: bool) -> bytes | None:
    """32 bytes; None where each start is to draw anew."""
    seed = site.clock.seed
    if seed is None:
        if not repeatable:
            return None
        seed = _UNSEEDED
    return hashlib.sha256(json.dumps([seed, process, purpose]).encode()).digest()
