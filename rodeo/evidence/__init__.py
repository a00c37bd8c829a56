"""Evidence of work: one sealed MCAP file per task, signed statements by devices, content-addressed stores.

`Recorder` writes a recording, `open_proof` reads one from a stranger, `open_bag` one that nobody sealed,
`Store` keeps and fetches them, `attest` and `verify_attestation` sign and check statements of other devices.
"""

from rodeo.evidence.attestation import Attestation, attest, verify_attestation
from rodeo.evidence.container import Limits
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.proof import Proof, open_proof
from rodeo.evidence.recorder import Recorder, SealedProof
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.evidence.unsealed import is_bag, is_never_sealed, open_bag

__all__ = [
    "Attestation",
    "Binding",
    "EvidenceError",
    "Limits",
    "Proof",
    "Recorder",
    "SealedProof",
    "Store",
    "attest",
    "is_bag",
    "is_never_sealed",
    "open_bag",
    "open_proof",
    "verify_attestation",
]
