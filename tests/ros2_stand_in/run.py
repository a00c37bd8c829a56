"""Runs a node as `python3 NODE.py ...` does, and says at its end what it has imported: run.py NODE.py ..."""

import json
import runpy
import sys
from pathlib import Path

import ros_interfaces  # noqa: F401 - from here on interface packages are there

if __name__ == "__main__":
    del sys.argv[0]
    sys.path[0] = str(Path(sys.argv[0]).parent)
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        print("modules", json.dumps(sorted({name.partition(".")[0] for name in sys.modules})), flush=True)
