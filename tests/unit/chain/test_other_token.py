"""What a deployment takes as payment token, and what it refuses."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from decimal import Decimal
from typing import Any

import pytest
from pydantic import ValidationError
from web3 import Web3

from deploy import contracts, founding
from rodeo.chain.client import connect
from rodeo.chain.contracts.abi import Terms
from rodeo.chain.contracts.types import Role
from rodeo.chain.node.errors import ContractReverted
from rodeo.site.config import Site
from rodeo.site.sections import BudgetConfig, GovernanceConfig, TermsConfig, TokenConfig
from tests.support.organization import Organization, running_chain
from tests.support.plain_token import create, init_code

pytestmark = pytest.mark.long

NO_DECIMALS = bytes.fromhex("6001600c60003960016000f300")
"""Makes a contract that stops, whatever it is asked."""
ALL_REVERTS = bytes.fromhex("6005600c60003960056000f360006000fd")
TERMS = TermsConfig(bond_iec=Decimal("20.5"), penalty_iec=Decimal("0.000001"))


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with running_chain("eth-tester", tmp_path_factory.mktemp("token")) as site:
        yield site


@pytest.fixture(scope="module")
def w3(chain: Site) -> Web3:
    return connect(chain.chain.url)


def paying_with(site: Site, address: str, decimals: int, **changed: Any) -> Site:
    token = TokenConfig(address=address, decimals=decimals)
    economy = site.economy.model_copy(update={"token": token})
    return site.model_copy(update={"economy": economy, **changed})


def test_an_organization_pays_with_the_token_of_the_site_file(chain: Site, w3: Web3) -> None:
    budgets = {"operator": BudgetConfig(iec=Decimal("100.25"))}
    governance = GovernanceConfig(terms=TERMS, budgets=budgets)  # type: ignore[arg-type]
    address = create(w3, init_code(6))
    site = paying_with(chain, address, 6, governance=governance)
    organization = Organization(site)
    organization.deploy()
    client = organization.client
    deployment = client.deployment
    assert (deployment.address("IECoin"), deployment.decimals, deployment.is_token_foreign) == (
        address,
        6,
        True,
    )
    assert client.rules.terms() == Terms(20_500_000, 1, 3)
    assert client.rules.budget(Role.OPERATOR).amount == 100_250_000
    assert client.token.total_supply() == 0, "nothing is minted"
    deployment.verify(w3)
    for wanted in (chain, paying_with(chain, address, 8), paying_with(chain, create(w3, init_code(6)), 6)):
        block = w3.eth.block_number
        with pytest.raises(founding.OtherToken) as refused:
            contracts.run(wanted, threading.Event())
        assert (refused.value.details["found"], refused.value.details["found_decimals"]) == (address, 6)
        assert w3.eth.block_number == block


def test_what_is_no_such_token_is_refused_before_anything_is_sent(chain: Site, w3: Web3) -> None:
    token, nobody = create(w3, init_code(6)), "0x" + "a1" * 20
    block = w3.eth.block_number
    with pytest.raises(founding.OtherToken) as refused:
        founding.existing_token(paying_with(chain, token, 8), w3)
    assert refused.value.details == {"address": token, "wanted_decimals": 8, "found_decimals": 6}
    with pytest.raises(founding.OtherToken, match="no contract"):
        founding.existing_token(paying_with(chain, nobody, 6), w3)
    assert founding.existing_token(paying_with(chain, token, 6), w3) == token
    assert founding.existing_token(chain, w3) is None
    assert w3.eth.block_number == block


@pytest.mark.parametrize("code", [NO_DECIMALS, ALL_REVERTS])
def test_a_contract_that_does_not_say_its_decimals_is_no_token(chain: Site, w3: Web3, code: bytes) -> None:
    address = create(w3, code)
    with pytest.raises(founding.OtherToken, match="does not say") as refused:
        founding.existing_token(paying_with(chain, address, 6), w3)
    assert refused.value.details == {"address": address}


@pytest.mark.parametrize("decimals", [0, 1, 19, 40])
def test_decimals_out_of_range_are_refused_by_the_site_file_and_the_contracts(
    chain: Site, w3: Web3, decimals: int
) -> None:
    with pytest.raises(ValidationError, match="decimals"):
        TokenConfig(address="0x" + "a1" * 20, decimals=decimals)
    address = create(w3, init_code(decimals))
    token = TokenConfig.model_construct(address=address, decimals=decimals)
    economy = chain.economy.model_copy(update={"token": token})
    folder = chain.data_dir.parent / f"{decimals}-decimals"
    with pytest.raises(ContractReverted) as refused:
        Organization(chain.model_copy(update={"economy": economy, "data_dir": folder})).deploy()
    assert refused.value.name == "UnsupportedDecimals"
    assert refused.value.args_by_name == {"token": address, "decimals": decimals, "min": 2, "max": 18}
