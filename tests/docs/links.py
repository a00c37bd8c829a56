"""`python -m tests.docs.links`: names each link of the documentation that leads nowhere."""

import sys

from tests.docs.text import broken_links

if __name__ == "__main__":
    found = broken_links()
    print("\n".join(found), file=sys.stderr)
    sys.exit(bool(found))
