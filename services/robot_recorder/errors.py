"""What a recorder refuses its mind.

RodeoError
└── RequestError
    ├── NotAssigned         the robot has no such attempt to do
    ├── RecordingRuns       another attempt is being recorded
    ├── RecordingOver       the attempt has been recorded: it is stopped, and not started again
    ├── StillWorking        what was asked for before is not done yet
    ├── NothingRecorded     no such attempt is, or was, recorded
    ├── OperatorsOrder      the robot is paused or stopped
    ├── WrongClock          the recorder's clock is not the site's
    ├── UnknownBin          the site has no such bin
    └── NothingGrasped      the fingers hold nothing, or held nothing then
"""

from __future__ import annotations

from rodeo.errors import RequestError


class NotAssigned(RequestError):
    """The robot has no such attempt to do."""


class RecordingRuns(RequestError):
    """Another attempt is being recorded; a second recording at the same time would be a fork."""


class RecordingOver(RequestError):
    """The attempt has been recorded."""


class StillWorking(RequestError):
    """What was asked for before is not done yet: ask again."""


class NothingRecorded(RequestError):
    """No such attempt is, or was, recorded."""


class OperatorsOrder(RequestError):
    """Operators paused or stopped the robot."""


class WrongClock(RequestError):
    """What the recorder stamps would prove nothing."""


class UnknownBin(RequestError):
    """The site has no bin of this name."""


class NothingGrasped(RequestError):
    """Nothing is between the fingers, or nothing was when the mind says that they closed."""
