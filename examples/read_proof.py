"""Read the poses that `rodeo proof export` wrote, and plot where each body went:
python read_proof.py FILE.derived.mcap PICTURE.png"""

import sys
from pathlib import Path

import matplotlib
from matplotlib import pyplot
from rosbags.highlevel import AnyReader

matplotlib.use("Agg")


def paths(file: Path) -> dict[str, list[tuple[float, float]]]:
    """Body -> its places in the map, m, in order."""
    found: dict[str, list[tuple[float, float]]] = {}
    with AnyReader([file]) as bag:
        for connection, _time_ns, data in bag.messages():
            if connection.topic == "/tf":
                for one in bag.deserialize(data, connection.msgtype).transforms:
                    at = one.transform.translation
                    found.setdefault(one.child_frame_id, []).append((at.x, at.y))
    return found


def main(file: str, picture: str) -> None:
    for body, path in paths(Path(file)).items():
        print(f"{body} ended at {path[-1][0]:.2f} {path[-1][1]:.2f}")
        pyplot.plot(*zip(*path, strict=True), label=body)
    pyplot.axis("equal")
    pyplot.legend()
    pyplot.savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:3])
