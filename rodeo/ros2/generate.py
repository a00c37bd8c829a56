"""Writes definitions.json: every interface of rosbags' store and of `interfaces.py`, with its RIHS01 hash.

python -m rodeo.ros2.generate
"""

from __future__ import annotations

import json
from pathlib import Path

from rodeo.ros2.types import build_store


def generated() -> str:
    """What is in definitions.json, an interface a line.

    A store of its own: that of the process may hold interfaces that other packages registered.
    """
    store = build_store()
    entries = {name: [store.hash_rihs01(name), *store.fielddefs[name]] for name in sorted(store.fielddefs)}
    lines = [
        f"{json.dumps(name)}:{json.dumps(entry, separators=(',', ':'))}" for name, entry in entries.items()
    ]
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    Path(__file__).with_name("definitions.json").write_text(generated())
