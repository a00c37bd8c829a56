"""What every RODEO process agrees on: configuration, keys, messages, clock, bus, chain client, evidence.

No service's behaviour lives here; a service imports `rodeo`, never another service.
"""

import os

# What eth-account and py-evm sign with. eth_keys' own default is pure Python, a thousand times as slow.
os.environ.setdefault("ECC_BACKEND_CLASS", "rodeo.ecc_backend.Libsecp256k1")
