"""What devices sign about what they saw, as links of one chain each that hold each other in order.

`Witness` is a device on the bus, `WitnessChain` signs, `Journal` remembers, `HeadBook` collects what others
signed; `parse` reads a statement, `track` the motion that motion capture signed.
"""

from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import (
    Claimant,
    Classification,
    Drop,
    Head,
    Header,
    Look,
    MeterRecord,
    Motion,
    Presentation,
    Receipt,
    Removal,
    Scope,
    Statement,
    parse,
    payload_digest,
)

__all__ = [
    "Claimant",
    "Classification",
    "Drop",
    "Head",
    "HeadBook",
    "Header",
    "Inputs",
    "Journal",
    "Look",
    "MeterRecord",
    "Motion",
    "Presentation",
    "Receipt",
    "Removal",
    "Scope",
    "Statement",
    "WitnessChain",
    "parse",
    "payload_digest",
]
