"""A picture of a site's lab: `python -m rodeo_cli.lab_picture --site FILE --out FILE.png`."""

import argparse
from pathlib import Path

from rodeo.config import Site
from rodeo.lab.render import Camera, encode
from rodeo.lab.world import begin, build_world


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", required=True, type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--camera", default="overview")
    parser.add_argument("--size", type=int, nargs=2, default=(1600, 900), metavar=("WIDTH", "HEIGHT"))
    arguments = parser.parse_args()
    site = Site.load(arguments.site)
    model = build_world(site)
    camera = Camera(model, arguments.camera, *arguments.size)
    arguments.out.write_bytes(encode(camera.image(begin(model, site)), arguments.out.suffix))
    camera.close()


if __name__ == "__main__":
    main()
