"""A picture of a site's lab: `python -m rodeo_cli.lab_picture --site FILE --out FILE.png`.

With `--recording FILE.mcap`, the proof of a cleaning, a moving picture of it: `--out FILE.webp`. Frames are
rendered on the processor where there is no GPU, about 5 a second.
"""

import argparse
from pathlib import Path

from rodeo.lab.render import Camera, encode
from rodeo.lab.world import begin, build_world
from rodeo.site.config import Site
from rodeo_cli.film import FRAMES_PER_S, Film, write


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--site", required=True, type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--camera", default="overview", help="of a picture")
    parser.add_argument("--recording", type=Path, help="proof of a cleaning; makes a moving picture")
    parser.add_argument("--size", type=int, nargs=2, metavar=("WIDTH", "HEIGHT"), help="in pixels")
    parser.add_argument("--frames-per-s", type=int, default=FRAMES_PER_S, help="of a moving picture")
    parser.add_argument("--quality", type=int, default=92, help="of a moving picture as WebP, up to 100")
    arguments = parser.parse_args()
    site, out = Site.load(arguments.site), arguments.out
    if arguments.recording is None:
        model = build_world(site)
        camera = Camera(model, arguments.camera, *(arguments.size or (1600, 900)))
        out.write_bytes(encode(camera.image(begin(model, site)), out.suffix))
        camera.close()
        return
    width, height = arguments.size or (720, 405)
    film = Film(arguments.recording, site, (width, height), arguments.frames_per_s)
    frames = write(film, out, arguments.quality)
    film.close()
    print(f"{out}: {frames} frames, {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
