"""The contracts' page says what a Solidity test computes, and names what the sources have."""

from __future__ import annotations

import re

from rodeo.chain import artifacts
from tests.docs.text import ROOT

PAGE = (ROOT / "docs/reference/contracts.md").read_text()
ENDS = (ROOT / "contracts/test/Ends.t.sol").read_text()
TASKS = "".join(
    (ROOT / f"contracts/src/interfaces/{name}.sol").read_text() for name in ("ITaskManager", "ITaskQueues")
)


def members(enum: str) -> list[str]:
    found = re.search(rf"^enum {enum} {{([^}}]*)}}", TASKS, re.MULTILINE)
    assert found
    return re.findall(r"\w+", found[1])


def rows_of(header: str) -> list[str]:
    """The rows of the table that has this header."""
    table = PAGE.split(header + "\n", 1)[1].split("\n\n", 1)[0]
    return table.splitlines()[1:]


def test_the_ends_of_an_attempt_are_those_that_the_contracts_have() -> None:
    rows = rows_of(
        "| end of an attempt | the task | the executor is paid | the creator has back | the attempt counts | "
        "penalty | bond | record |"
    )
    assert rows == re.findall(r'"(\|[^"]*\|)"', ENDS)
    names = [row.split(" | ")[0].removeprefix("| ") for row in rows]
    assert set(names) == set(members("Ruling")[1:]) | set(members("Cause"))


def test_the_figure_of_a_task_has_all_its_states() -> None:
    figure = PAGE.split("stateDiagram-v2", 1)[1].split("```", 1)[0]
    assert set(re.findall(r"\b[A-Z][a-z]+\b", figure)) == set(members("TaskState")[1:])


def test_rulings_and_faults_are_explained() -> None:
    rows = rows_of("| ruling | means |")
    assert [row.split(" | ")[0].removeprefix("| ") for row in rows] == members("Ruling")[1:]
    assert all(fault in rows[-1] for fault in members("Fault"))


ARROW = re.compile(r"\s*-->\s*(?:\|([^|]*)\|\s*)?")
POLICY = "FirstComeFirstServed"


def calls(figure: str) -> list[tuple[str, str]]:
    """(Contract, function) of each name on an arrow. A dotted arrow is no call."""
    found = []
    for line in figure.strip().splitlines()[1:]:
        _, *steps = ARROW.split(line.strip())
        for label, targets in zip(steps[::2], steps[1::2], strict=True):
            assert label, f"an arrow without a function: {line}"
            for target in targets.split(" & "):
                found += [
                    (POLICY if target == "Policy" else target, name) for name in re.findall(r"\w+", label)
                ]
    return found


def test_who_calls_whom_names_functions_that_the_called_contracts_have() -> None:
    figure = PAGE.split("```mermaid\nflowchart", 1)[1].split("```", 1)[0]
    drawn = calls(figure)
    assert len(drawn) > 50
    missing = [
        (contract, name)
        for contract, name in drawn
        if name not in {one.get("name") for one in artifacts.load(contract).abi if one["type"] == "function"}
    ]
    assert not missing
