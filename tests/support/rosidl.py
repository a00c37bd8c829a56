"""The definitions of a ROS package translated to IDL, and each IDL parsed, by Debian's rosidl-tools.

    /usr/bin/python3 tests/support/rosidl.py PACKAGE OUT

prints the files that it has read. It runs in the system's Python, which has rosidl.
"""

import sys
from pathlib import Path

from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_parser.definition import IdlLocator
from rosidl_parser.parser import parse_idl_file

CONVERT = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl, ".action": convert_action_to_idl}


def main(package: Path, out: Path) -> None:
    for path in sorted(package.rglob("*.*")):
        if (convert := CONVERT.get(path.suffix)) is not None:
            where = out / path.parent.name
            where.mkdir(parents=True, exist_ok=True)
            idl = convert(package, package.name, path.relative_to(package), where)
            parse_idl_file(IdlLocator(out, idl.relative_to(out)))
            print(path.relative_to(package), file=sys.stderr)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
