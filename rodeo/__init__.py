"""Everything on which all RODEO processes agree, in rooms: each room's docstring lists what it holds and what
not.

Loose here: `dao` for programs that take part, `kinds`, `errors`, `payloads`. No service's behaviour is here.
"""

import os

# What eth-account and py-evm sign with. eth_keys' own default is pure Python, a thousand times as slow.
os.environ.setdefault("ECC_BACKEND_CLASS", "rodeo.signing.ecc_backend.Libsecp256k1")
