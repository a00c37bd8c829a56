"""Error codes."""

import pytest

from rodeo.chain.node import errors as chain_errors
from rodeo.errors import _PASSING, InvalidRequest, RemoteError, snake_case
from services.bridge import errors as bridge_errors


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


def test_what_passes_by_itself_are_errors_of_bridge_chain_and_bus() -> None:
    known = {snake_case(name) for module in (bridge_errors, chain_errors) for name in vars(module)}
    assert {"internal"} | known >= _PASSING
    assert RemoteError("chain_unavailable", "the node does not answer").passes
    assert not RemoteError("insufficient_funds", "the wallet has less").passes
