"""ROS 1 packages that Debian has not: control_msgs, move_base_msgs and rodeo_msgs, made with genpy.

/usr/bin/python3 tests/noetic_robot/generate.py OUT RODEO_MSGS
"""

from __future__ import annotations

import sys
from pathlib import Path

from definitions import definitions, messages_of
from genpy.generate_initpy import write_modules
from genpy.generator import MsgGenerator, SrvGenerator


def main(out: Path, rodeo_msgs: Path) -> None:
    search: dict[str, list[str]] = {
        path.parent.name: [str(path)] for path in Path("/usr/share").glob("*_msgs/msg")
    }
    texts: dict[tuple[str, str], dict[str, str]] = {}
    for full_name, text in definitions(rodeo_msgs).items():
        package, form, name = full_name.split("/")
        made = messages_of(name, text) if form == "action" else {name: text}
        texts.setdefault((package, "srv" if form == "srv" else "msg"), {}).update(made)
    files = {}
    for (package, form), made in texts.items():
        folder = out / "definitions" / package / form
        folder.mkdir(parents=True)
        search.setdefault(package, []).append(str(folder))
        files[package, form] = [folder / f"{name}.{form}" for name in made]
        for path in files[package, form]:
            path.write_text(made[path.stem])
    for (package, form), paths in files.items():
        generator = SrvGenerator() if form == "srv" else MsgGenerator()
        folder = out / "python" / package / form
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()
        failed = generator.generate_messages(package, [str(path) for path in paths], str(folder), search)
        assert not failed, package
        write_modules(str(folder))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
