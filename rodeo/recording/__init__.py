"""What a recorder on a site does beside writing: tell of its seals, and decide what may be written.

`SealPublisher` tells witnesses of each seal, `PictureFetcher` gets what the bin saw, `MessageDoor` and
`StatementListener` keep out what would spoil a recording, and `Refusals` counts it.
"""

from rodeo.recording.door import MessageDoor, Refusal, Refusals
from rodeo.recording.pictures import PictureFetcher
from rodeo.recording.seals import SealPublisher
from rodeo.recording.statements import Heard, StatementDoor, StatementListener

__all__ = [
    "Heard",
    "MessageDoor",
    "PictureFetcher",
    "Refusal",
    "Refusals",
    "SealPublisher",
    "StatementDoor",
    "StatementListener",
]
