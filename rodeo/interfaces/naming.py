"""What ROS, C++ and Python accept as names: one rule, and what it makes the same is refused."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable

from rodeo.errors import RodeoError

_CPP = frozenset(
    """
    alignas alignof and_eq asm auto bitand bitor bool case catch char compl const const_cast constexpr
    decltype default delete do double dynamic_cast enum explicit export extern float friend goto inline
    int long mutable namespace new noexcept not_eq nullptr operator or_eq private protected public
    register reinterpret_cast short signed sizeof static static_assert static_cast struct switch
    template this thread_local throw typedef typeid typename union unsigned using virtual void volatile
    wchar_t xor xor_eq
    """.split()  # noqa: SIM905 - one a line would be a page
)
_FIELD = re.compile(r"[a-z](_?[a-z0-9]+)*")


class NameCollision(RodeoError):
    """Two names are the same in ROS."""


def field_name(name: str) -> str:
    """The field `name` in a message: `_value` behind what is a word of Python or C++, lower case throughout,
    one underscore at a time."""
    plain = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", name.lower())).strip("_")
    if keyword.iskeyword(plain) or plain in _CPP:
        plain += "_value"
    if not _FIELD.fullmatch(plain):
        raise NameCollision(f"{name!r} has no name in ROS", name=name)
    return plain


def interface_name(name: str) -> str:
    """`task/{id}` and `register_task` in camel case, for files and types."""
    words = re.findall(r"[A-Za-z0-9]+", re.sub(r"\{\w+\}", "", name))
    return "".join(word[0].upper() + word[1:] for word in words)


def service_name(interface: str) -> str:
    """`RegisterTask` -> `register_task`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", interface).lower()


def distinct(names: Iterable[str], where: str) -> None:
    """Raises NameCollision. File systems and generators may not tell upper from lower case."""
    seen: set[str] = set()
    for name in names:
        if name.lower() in seen:
            raise NameCollision(f"{where} has {name!r} twice", where=where, name=name)
        seen.add(name.lower())
