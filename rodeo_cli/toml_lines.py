"""Line numbers of values in a TOML file, which `tomllib` does not report."""

from __future__ import annotations

import re
import tomllib

Place = tuple[str | int, ...]

_TOKEN = re.compile(
    r'''(?P<comment>\#[^\n]*)|(?P<long>"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\')'''
    r"""|(?P<string>"(?:\\.|[^"\\\n])*"|'[^'\n]*')|(?P<mark>[\[\]{}=,.\n])|(?P<bare>[^\s\[\]{}=,.\#"']+)""",
    re.DOTALL,
)


def lines_of(text: str) -> dict[Place, int]:
    """Place of each table, key and entry of a list -> the line (from 1) on which it begins. `text` is TOML.

    A value without a line of its own (a float's part behind the dot) has none.
    """
    return _Reader(text).read()


class _Reader:
    def __init__(self, text: str) -> None:
        self._tokens = [
            (match.lastgroup or "", match.group(), text.count("\n", 0, match.start()) + 1)
            for match in _TOKEN.finditer(text)
            if match.lastgroup != "comment"
        ]
        self._at = 0
        self._lines: dict[Place, int] = {}
        self._counts: dict[Place, int] = {}
        """Entries of each array of tables so far."""

    def read(self) -> dict[Place, int]:
        table: Place = ()
        while (token := self._peek()) is not None:
            if token[1] == "\n":
                self._at += 1
            elif token[1] == "[":
                table = self._header()
            else:
                self._pair(table)
        return self._lines

    def _peek(self) -> tuple[str, str, int] | None:
        return self._tokens[self._at] if self._at < len(self._tokens) else None

    def _next(self) -> tuple[str, str, int]:
        self._at += 1
        return self._tokens[self._at - 1]

    def _header(self) -> Place:
        line = self._next()[2]
        array = self._is("[")
        if array:
            self._at += 1
        place = self._inside(self._key())
        while self._peek() is not None and self._is("]"):
            self._at += 1
        if array:
            number = self._counts.get(place, 0)
            self._counts[place] = number + 1
            self._lines.setdefault(place, line)
            place = (*place, number)
        self._lines.setdefault(place, line)
        return place

    def _inside(self, key: Place) -> Place:
        """A header's key, where what is inside an array of tables is inside its last entry."""
        place: Place = ()
        for number, step in enumerate(key):
            place = (*place, step)
            if number < len(key) - 1 and place in self._counts:
                place = (*place, self._counts[place] - 1)
        return place

    def _pair(self, table: Place) -> None:
        token = self._peek()
        assert token is not None
        key = self._key()
        place = table
        for step in key:
            place = (*place, step)
            self._lines.setdefault(place, token[2])
        if self._is("="):
            self._at += 1
            self._value(place)
        elif self._at < len(self._tokens):
            self._at += 1  # no TOML: the parser reports it

    def _key(self) -> Place:
        key: list[str | int] = []
        while (token := self._peek()) is not None and (token[0] in ("bare", "string") or token[1] == "."):
            if token[0] == "string":
                key.append(str(tomllib.loads(f"key = {token[1]}")["key"]))
            elif token[0] == "bare":
                key.append(token[1])
            self._at += 1
        return tuple(key)

    def _is(self, mark: str) -> bool:
        token = self._peek()
        return token is not None and token[1] == mark

    def _value(self, place: Place) -> None:
        if self._is("["):
            self._at += 1
            number = 0
            while (token := self._peek()) is not None and token[1] != "]":
                if token[1] in ("\n", ","):
                    self._at += 1
                    continue
                self._lines.setdefault((*place, number), token[2])
                self._value((*place, number))
                number += 1
            self._at += 1
        elif self._is("{"):
            self._at += 1
            while (token := self._peek()) is not None and token[1] != "}":
                if token[1] in ("\n", ","):
                    self._at += 1
                else:
                    self._pair(place)
            self._at += 1
        else:
            while (token := self._peek()) is not None and token[1] not in ("\n", ",", "]", "}"):
                self._at += 1
