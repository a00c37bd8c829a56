"""The console's parts in the tests' own process."""

from functools import partial

import pytest
from argon2 import PasswordHasher


@pytest.fixture(autouse=True)
def passphrases_are_hashed_cheaply(monkeypatch: pytest.MonkeyPatch) -> None:
    """As argon2id still, with the least work and memory: these passphrases protect nothing."""
    cheap = partial(PasswordHasher, time_cost=1, memory_cost=8, parallelism=1)
    monkeypatch.setattr("rodeo.access.accounts.PasswordHasher", cheap)
