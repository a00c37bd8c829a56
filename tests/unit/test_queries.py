"""Questions to the index: what fits is an object, what does not is an error that names the field."""

from typing import Any

import pytest

from rodeo.bus import queries
from rodeo.commands.services import RegisterService
from rodeo.dao import Participant
from rodeo.errors import MalformedAnswer
from rodeo_testing import answers


class Bridge:
    """Answers everything alike; remembers what it was asked."""

    def __init__(self, answer: dict[str, Any]) -> None:
        self.answer = answer
        self.asked: list[tuple[str, Any]] = []

    def query(self, key: str, payload: Any = None, *, parameters: Any = None, timeout_s: float = 10) -> Any:
        self.asked.append((key, parameters))
        return self.answer


def test_an_answer_that_fits_is_an_object_with_its_fields() -> None:
    bridge = Bridge(answers.chain(head=12))
    chain = queries.ask(bridge, "lab", queries.CHAIN)
    assert (chain.head, chain.contracts.task_manager) == (12, answers.CONTRACTS["TaskManager"])
    assert bridge.asked == [("rodeo/lab/state/chain", {})]


def test_what_a_newer_bridge_says_beside_it_is_ignored() -> None:
    assert queries.ask(Bridge(answers.chain(colour="blue")), "lab", queries.CHAIN).chain_id == 31337


@pytest.mark.parametrize(
    ("query", "answer", "field"),
    [
        (queries.CHAIN, answers.chain(contracts={}), "contracts.Organization"),
        (queries.CHAIN, answers.chain(head="many"), "head"),
        (queries.DEVICES, {}, "devices"),
        (queries.DEVICES, {"devices": [{"address": "0x"}]}, "devices.0.role"),
        (queries.ROOTS, {"roots": None, "total": 0}, "roots"),
        (queries.TASKS, {"tasks": [{"id": 1}], "total": 1}, "tasks.0.kind"),
        (queries.EVENTS, answers.events([{"seq": 1}]), "events.0.name"),
        (queries.WALLETS, {"wallets": [], "supply_iec": "much"}, "supply_iec"),
    ],
)
def test_an_answer_that_does_not_fit_names_key_and_field(
    query: queries.Query[Any], answer: dict[str, Any], field: str
) -> None:
    with pytest.raises(MalformedAnswer) as caught:
        queries.ask(Bridge(answer), "lab", query)
    assert caught.value.details["key"] == f"rodeo/lab/state/{query.what}"
    assert field in caught.value.details["fields"]


def test_parameters_that_are_none_are_left_out_and_an_id_is_part_of_the_key() -> None:
    bridge = Bridge({})
    with pytest.raises(MalformedAnswer):
        queries.ask(bridge, "lab", queries.TASK, id=7, kind=None, limit=5)
    assert bridge.asked == [("rodeo/lab/state/task/7", {"limit": 5})]


def test_amounts_are_told_again_as_they_were_heard() -> None:
    heard = answers.wallets({"alice": answers.ADDRESS}) | {"supply_iec": "0.000000000000000001"}
    assert queries.Wallets.model_validate(heard).model_dump(mode="json") == heard


def test_contracts_are_told_again_under_their_own_names() -> None:
    heard = answers.organization(audited=["sweeping"])
    heard["contracts"] = answers.CONTRACTS | {"IECoin": answers.ADDRESS}
    assert queries.Organization.model_validate(heard).model_dump(mode="json", by_alias=True) == heard


def test_a_command_whose_answer_is_no_transaction_is_a_malformed_answer() -> None:
    alice = Participant(Bridge({"task_id": 7}), "lab", "alice")  # type: ignore[arg-type]
    with pytest.raises(MalformedAnswer) as caught:
        alice.command("register_service", RegisterService(kind="sweeping", price_iec=1))  # type: ignore[arg-type]
    assert caught.value.details["key"] == "rodeo/lab/wallet/alice/register_service"


def test_every_question_of_the_table_has_a_model_of_its_own() -> None:
    models = [query.answer for query in queries.QUERIES.values()]
    assert len(set(models)) == len(models) == 17
