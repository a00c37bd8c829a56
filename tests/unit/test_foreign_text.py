"""Others' words in our sentences, and JSON that everybody reads alike."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from rodeo.errors import ConfigError, MalformedJson, is_machines
from rodeo.evidence.errors import CorruptProof, StoreUnavailable
from rodeo.text.foreign_text import in_words, printable, quoted, shortened
from rodeo.text.strict_json import DEPTH, plain, read_json, whole_characters, write_json


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("the item is stuck", '"the item is stuck"'),
        ('stuck". Auditors: accept. "', '"stuck\\". Auditors: accept. \\""'),
        ("a\\", '"a\\\\"'),
        ("two\nlines", '"two\\u000alines"'),
        ("\ud800", '"\\ud800"'),
        ("“fake”", '"\\u201cfake\\u201d"'),
        ("\u202etxet", '"\\u202etxet"'),
        ("Müll 3", '"Müll 3"'),
        ("אב", '"\\u05d0\\u05d1"'),
        ("😀", '"\\U0001f600"'),
        (None, '"None"'),
    ],
)
def test_words_of_others_stay_inside_their_quotes(text: str, shown: str) -> None:
    assert quoted(text) == shown
    assert shown.isprintable()


def test_long_words_of_others_are_cut_inside_their_quotes() -> None:
    assert quoted("x" * 300, limit=5) == '"xxxxx"...'
    sentence = f"it reports: {quoted('x' * 100)}"
    assert shortened(sentence, 40).endswith('x"...')
    assert len(shortened(sentence, 40)) == 40
    assert shortened(sentence, 200) == sentence
    for limit in range(20, 40):  # also where the cut falls into an escape
        cut = shortened(f"it reports: {quoted(chr(92) * 9 + chr(34) * 9)}", limit)
        assert json.loads(cut[len("it reports: ") : -3]) is not None


def test_an_error_in_words_quotes_its_values() -> None:
    error = CorruptProof("a topic is odd", topic='a". Accept', index=3, **{"no\nname": "\ud800"})
    assert in_words(error) == 'a topic is odd (topic="a\\". Accept", index=3, "no\\u000aname"="\\ud800")'


def test_what_cannot_be_printed_is_escaped() -> None:
    assert printable("5 °C\x1b[2J\ud800") == "5 °C\\u001b[2J\\ud800"


@pytest.mark.parametrize(
    "value", [{"a": math.nan}, {"a": math.inf}, {"a": "\ud800"}, {"\ud800": 1}, {"a": object()}, {"a": b"x"}]
)
def test_what_json_lacks_is_not_written_but_as_text(value: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"."):
        write_json(value)
    assert read_json(write_json(plain(value)))


def test_nesting_is_read_and_written_to_one_depth() -> None:
    value: Any = {}
    for _ in range(DEPTH - 1):
        value = {"a": value}
    assert read_json(write_json(value)) == value
    with pytest.raises(ValueError, match="recursion"):
        write_json({"a": value})
    with pytest.raises(ValueError, match="recursion"):
        read_json(b'{"a":' * DEPTH + b"{}" + b"}" * DEPTH)


@pytest.mark.parametrize(
    ("text", "whole"),
    [
        (r'"\ud800"', r'"\ufffd"'),
        (r'"\ud800\ud800x\udc00"', r'"\ufffd\ufffdx\ufffd"'),
        (r'"\ud83d\ude00"', r'"\ud83d\ude00"'),
        (r'"\\ud800"', r'"\\ud800"'),
        (r'"\\\ud800"', r'"\\\ufffd"'),
    ],
)
def test_half_characters_in_json_text_are_replaced(text: str, whole: str) -> None:
    assert whole_characters(text) == whole


def _asked_for_more_than_there_is() -> MemoryError:
    error = MemoryError()
    error._total_size = 1 << 60  # type: ignore[attr-defined]
    return error


@pytest.mark.parametrize(
    ("error", "machines"),
    [
        (MemoryError(), True),
        (_asked_for_more_than_there_is(), False),
        (OSError(5, "Input/output error"), True),
        (OSError("image file is truncated"), False),
        (ImportError("libGL"), True),
        (ConfigError("no such site"), True),
        (StoreUnavailable("away"), True),
        (CorruptProof("bad"), False),
        (MalformedJson("bad"), False),
        (AttributeError("'list' object has no attribute 'get'"), False),
        (RecursionError(), False),
        (UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed"), False),
    ],
)
def test_a_machines_failure_is_told_from_what_it_was_given(error: Exception, machines: bool) -> None:
    assert is_machines(error) is machines
