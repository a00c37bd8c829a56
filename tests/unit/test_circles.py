"""The linter's contract about circles of files."""

import grimp
import pytest

from tests.support.circles import NoCircles


@pytest.mark.parametrize(
    ("imports", "kept"),
    [
        ([("a.one", "a.two"), ("a.two", "b")], True),
        ([("a.one", "b"), ("b", "a.two"), ("a.two", "a.one")], False),
        ([("a", "a.one"), ("a.one", "a")], False),
    ],
    ids=["no circle", "over three files", "a package and what lies in it"],
)
def test_a_circle_of_files_breaks_the_contract(imports: list[tuple[str, str]], kept: bool) -> None:
    graph = grimp.ImportGraph()
    for importer, imported in imports:
        graph.add_import(importer=importer, imported=imported)
    contract = NoCircles(name="no circles", session_options={}, contract_options={})
    assert contract.check(graph, verbose=False).kept is kept
