"""The one charset in which an HTTP body's texts are read.

Starlette decodes a form's texts by any codec of Python's that the header names, and some take minutes for a
megabyte, in which nobody is served.
"""

from __future__ import annotations

import codecs

from python_multipart.multipart import parse_options_header

_PLAIN = ("utf-8", "ascii")
"""ASCII is a part of UTF-8."""


def is_utf8(content_type: str) -> bool:
    """Whether a Content-Type (RFC 9110, 8.3) names UTF-8, or no charset."""
    _, options = parse_options_header(content_type)
    try:
        return codecs.lookup(options.get(b"charset", b"utf-8").decode("latin-1")).name in _PLAIN
    except LookupError:
        return False
