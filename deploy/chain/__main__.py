"""python -m deploy.chain --site deploy/sites/lab.toml"""

import sys

from deploy.chain.process import run
from rodeo.runtime.process import main

if __name__ == "__main__":
    sys.exit(main("chain", run, "The local chain: Ethereum JSON-RPC on the site's chain URL."))
