"""Error codes."""

import pytest

from rodeo.errors import InvalidRequest, snake_case


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("InsufficientFunds", "insufficient_funds"),
        ("ERC20InsufficientBalance", "erc20_insufficient_balance"),
        ("NoResponder", "no_responder"),
        ("URITooLong", "uri_too_long"),
    ],
)
def test_a_name_becomes_a_code(name: str, code: str) -> None:
    assert snake_case(name) == code


def test_an_error_tells_its_code_sentence_and_values() -> None:
    error = InvalidRequest("wrong", field="reward_iec")
    assert error.to_json() == {
        "code": "invalid_request",
        "message": "wrong",
        "details": {"field": "reward_iec"},
    }
    assert str(error) == "wrong (field='reward_iec')"
