"""`tools/shape.py` measures the code; what is over a limit is on a list whose numbers only shrink."""

from __future__ import annotations

import ast

from tools import shape


def test_what_grew_or_is_new_is_named() -> None:
    left = {"functions": {"a.py:f": 70}, "classes": {"a.py:C": [400, 34, 3, 2]}}
    found = {
        "functions": {"a.py:f": 70, "a.py:g": 61},
        "classes": {"a.py:C": [390, 35, 9, 2], "D": [351, 1, 1, 1]},
    }
    assert shape.grown(found, left) == ["functions: a.py:g", "classes: a.py:C", "classes: D"]
    assert shape.grown(left, found) == ["classes: a.py:C"]
    assert shape.gone(left, found) == []
    assert shape.gone(found, left) == ["functions: a.py:g", "classes: D"]


def test_a_class_counts_fields_that_it_sets_methods_and_parts() -> None:
    source = """
class Bin:
    def __init__(self, bus, *, clock):
        self.bus, self._clock = bus, clock

    @property
    def mass(self):
        self.read = self.bus.mass
        return self.read
"""
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    assert shape.measured(node) == shape.Class(8, 2, {"bus", "_clock", "read"}, 2)
