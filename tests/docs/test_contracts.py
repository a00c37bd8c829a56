"""The contracts' page says what a Solidity test computes, and names what the sources have."""

from __future__ import annotations

import re

from rodeo.chain import artifacts
from rodeo.checks.report import Check, Finding, Report, given_up, impossible, undecided
from rodeo_testing.ends import ENDS, Judging, ended
from tests.docs.text import ROOT

PAGE = (ROOT / "docs/reference/contracts.md").read_text()
COMPUTED = {name: (ROOT / f"contracts/test/{name}.t.sol").read_text() for name in ("Ends", "Silence")}
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


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip("|").split("|")]


ENDS_HEADER = (
    "| end of an attempt | the task | the executor is paid | the creator has back | the attempt counts | "
    "penalty | bond | record |"
)
SILENCE_HEADER = "| judges | the case ends |"


def test_the_ends_of_an_attempt_are_those_that_the_contracts_have() -> None:
    rows = rows_of(ENDS_HEADER)
    assert rows == re.findall(r'"(\|[^"]*\|)"', COMPUTED["Ends"])
    names = [row.split(" | ")[0].removeprefix("| ") for row in rows]
    assert set(names) == set(members("Ruling")[1:]) | set(members("Cause"))


def test_cases_without_a_judge_end_as_the_contracts_have_it() -> None:
    assert rows_of(SILENCE_HEADER) == re.findall(r'"(\| [^"]*[^ ] \|)"', COMPUTED["Silence"])


def test_forgeries_are_paid_what_the_contracts_pay() -> None:
    """`rodeo_testing.ends` has the two tables."""
    found = {cells(row)[0]: cells(row) for row in rows_of(ENDS_HEADER)}
    for ruling, end in ENDS.items():
        row = found["".join(word.capitalize() for word in ruling.split("_"))]
        assert (end.paid, end.penalty) == (row[2], row[5])
        assert end.pays == (row[2] != "nothing")
        assert end.is_fine == (row[5].partition(";")[0] != "none")


FINDINGS = {
    "accepted": Finding(passed=True),
    "rejected": Finding(passed=False),
    "given_up": given_up(""),
    "impossible": impossible("", "nobody"),
}
JUDGINGS: dict[str, Judging] = {
    "nobody rules": "silent",
    "too few votes are equal": "split",
    "the judge is removed, and nobody else rules": "removed",
    "nobody answers a challenge": "unanswered",
}


def test_forgeries_end_as_the_contracts_have_it_where_judges_say_nothing() -> None:
    def report(finding: Finding) -> Report:
        return Report.of([Check.of("check", finding)])

    passed_on = "the judge passes the case on, and nobody else rules"
    ends = dict(map(cells, rows_of(SILENCE_HEADER)))
    assert ends.keys() == {*JUDGINGS, passed_on}
    assert ends[passed_on].lower() == ended(report(undecided("", "nobody")))
    for ruling, finding in FINDINGS.items():
        assert ended(report(finding)) == ruling
        for judges, judging in JUDGINGS.items():
            as_ruled = ends[judges] == "as it was ruled"
            assert ended(report(finding), judging) == (ruling if as_ruled else ends[judges].lower())


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
