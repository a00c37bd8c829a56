"""The code on a person's photo: one per assignment, and readable in handwriting."""

from __future__ import annotations

from rodeo.person.photo_code import ALPHABET, photo_code

NONCE = "0x" + "22" * 32


def test_an_assignment_has_one_code_however_its_nonce_is_written() -> None:
    assert photo_code(NONCE) == photo_code(NONCE.removeprefix("0x")) == photo_code("0x" + ("22" * 32).upper())
    assert photo_code(NONCE) != photo_code("0x" + "23" * 32)


def test_a_code_is_five_letters_and_digits_that_nobody_confuses() -> None:
    codes = [photo_code(f"0x{number:064x}") for number in range(500)]
    assert all(len(code) == 6 and code[2] == "-" for code in codes)
    used = set("".join(codes)) - {"-"}
    assert used == set(ALPHABET)
    assert not used & set("0O1IL2Z5S8BU")
    assert len(set(codes)) == len(codes)
