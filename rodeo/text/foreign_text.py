"""Text that others wrote, where it stands in our own sentences.

A verdict's reason is read by people who decide about money. Words of the party that is judged stand in double
quotes, which nothing inside them can close, and without characters that hide, reorder or imitate others.
"""

from __future__ import annotations

import unicodedata

from rodeo.errors import RodeoError

QUOTED_CHARACTERS = 200


def printable(text: str) -> str:
    """`text` with escapes for what cannot be printed: surrogates, control and format characters."""
    return text if text.isprintable() else "".join(c if c.isprintable() else _escape(c) for c in text)


def quoted(value: object, limit: int = QUOTED_CHARACTERS) -> str:
    """The text of `value` in double quotes. Outside of ASCII only letters and digits that are written from
    left to right stand as they are. Longer text than `limit` characters is cut: "..." follows the quotes."""
    text = str(value)
    inner = "".join(c if _harmless(c) else _escape(c) for c in text[:limit])
    return f'"{inner}"{"..." if len(text) > limit else ""}'


def shortened(text: str, limit: int) -> str:
    """The beginning of a sentence that holds quoted words, which stay in their quotes."""
    if len(text) <= limit:
        return text
    text = text[: limit - 4]
    inside = escaped = False
    for c in text:
        inside ^= c == '"' and not escaped
        escaped = c == "\\" and not escaped
    if inside and escaped:
        text = text[:-1]  # half of an escape would escape the closing quote
    return f"{text}{chr(34) if inside else ''}..."


def _harmless(c: str) -> bool:
    if c.isascii():
        return c.isprintable() and c not in '"\\'
    return c.isalnum() and unicodedata.bidirectional(c) == "L"


def _escape(c: str) -> str:
    if c in '"\\':
        return "\\" + c
    return f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}"


def in_words(error: RodeoError) -> str:
    """What `str` says of it, with quoted values."""
    if not error.details:
        return printable(error.message)
    return f"{printable(error.message)} ({', '.join(_named(*one) for one in error.details.items())})"


def _named(name: str, value: object) -> str:
    shown = str(value) if value is None or isinstance(value, bool | int | float) else quoted(value)
    return f"{name if name.isascii() and name.isidentifier() else quoted(name)}={shown}"
