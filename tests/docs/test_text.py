"""What the documentation says is so: options and files exist, snippets are valid, links lead somewhere."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh
from rodeo_ros1.config import load
from rodeo_ros1.layouts import Layouts

from rodeo.kinds import kinds_of
from rodeo.lab.world import robot_model
from rodeo.site.config import Site
from services.robot_sim.urdf import to_urdf
from tests.docs.not_run import NOT_RUN, reason
from tests.docs.text import (
    ROOT,
    Block,
    Command,
    blocks,
    broken_links,
    broken_links_of,
    commands,
    mentioned,
    pages,
)
from tests.support import command
from tests.support.site import LAB

MADE_BY_THE_READER = {
    "/etc/rodeo/site.toml",
    "my-site.toml",
    "my_bin.py",
    "photo.jpg",
    "wheels.jpg",
    "site.toml",
}
MADE_BY_THE_READER |= {"my-site/site.toml", "out/demo/site.toml"}
"""Files of which the text says that the reader brings them or writes them."""
KINDS = {
    "{toctree}",
    "{literalinclude}",
    "shell",
    "toml",
    "python",
    "json",
    "yaml",
    "mermaid",
    "question",
    "diagram",
    "diff",
    "text",
}
DIAGRAMS = {"docs/reference/evidence.md"}
"""Pages with blocks that are only to be looked at."""
INTERFACES = {"docs/reference/ros2.md"}
"""The page whose blocks are files of `rodeo_msgs` (tests/unit/interfaces)."""
PLACEHOLDERS = {'"0x..."': '"0x' + "1f" * 20 + '"'}


def identified(things: list[Any]) -> Any:
    return pytest.mark.parametrize("thing", things, ids=list(map(str, things)))


def of_kind(kind: str) -> list[Block]:
    return [block for block in blocks() if block.kind == kind]


# -- every block is one of these ---------------------------------------------------------------------------


def test_every_block_is_checked_as_what_it_is() -> None:
    unknown = [str(block) for block in blocks() if block.kind not in KINDS]
    assert unknown == []
    assert {block.page for block in of_kind("diagram")} <= DIAGRAMS
    assert {block.page for block in of_kind("text")} <= INTERFACES


def test_what_is_not_run_stands_in_the_text_still() -> None:
    assert set(NOT_RUN) <= {command.text for command in commands()}


@identified([block for kind in ("python", "json") for block in of_kind(kind)])
def test_programs_compile_and_examples_are_json(thing: Block) -> None:
    if thing.kind == "python":
        ast.parse(thing.text)
    else:
        assert isinstance(json.loads(thing.text), dict)


@identified(of_kind("yaml"))
def test_what_a_relay_carries_is_read_by_it(thing: Block, tmp_path: Path) -> None:
    said = {"router": "tcp/127.0.0.1:7447", **yaml.safe_load(thing.text)}
    for name in said.get("tls", {}).values():
        (tmp_path / name).touch()
    (tmp_path / "relay.yaml").write_text(yaml.safe_dump(said))
    carried = load(str(tmp_path / "relay.yaml"), Layouts.load()).entries
    assert any(carried.values())


@identified(of_kind("toml"))
def test_a_snippet_appended_to_a_site_file_makes_a_valid_site(thing: Block, tmp_path: Path) -> None:
    text = thing.text
    for written, meant in PLACEHOLDERS.items():
        text = text.replace(written, meant)
    for name in ("arthur", "panther"):
        (tmp_path / f"{name}.urdf").write_text(to_urdf(robot_model(), name))
    own = tomllib.loads(text)
    if "extends" in own:  # a whole site file
        text = text.replace('"deploy/sites/lab.toml"', json.dumps(str(LAB)))
    else:
        text = f"extends = {json.dumps(str(LAB))}\n{text}"
    path = tmp_path / "site.toml"
    path.write_text(text)
    site = Site.load(path)
    for name, value in own.items():
        if name not in ("extends", "data_dir"):
            assert_says(site.model_dump(mode="json"), name, value)


def assert_says(site: dict[str, Any], name: str, value: Any) -> None:
    """The loaded site says what the snippet says, so that nothing of it is left out."""
    assert name in site, name
    if isinstance(value, dict):
        for inner, one in value.items():
            assert_says(site[name], inner, one)
    elif isinstance(value, list):
        assert len(site[name]) == len(value)


def test_the_snippet_of_participants_may_also_stand_at_the_end_of_the_labs_own_file(tmp_path: Path) -> None:
    (snippet,) = [block.text for block in of_kind("toml") if "agent.maintenance" in block.text]
    path = tmp_path / "lab.toml"
    path.write_text(LAB.read_text() + "\n" + snippet)
    assert [one.name for one in Site.load(path).participants] == ["alice"]


# -- commands ----------------------------------------------------------------------------------------------


_WRITTEN = frozenset(commands())


@identified([*commands(), *mentioned()])
def test_a_command_has_the_options_and_files_that_it_is_told_with(thing: Command) -> None:
    written_in_full = thing in _WRITTEN
    program, *words = thing.words
    match program:
        case "rodeo" | "/opt/rodeo/bin/rodeo":
            check_rodeo(words, written_in_full)
        case "make":
            check_make(words)
        case "npm":
            scripts = json.loads((ROOT / "package.json").read_text())["scripts"]
            assert words[0] == "run" and words[1] in scripts, words
        case "python" if words[:2] == ["-m", "pytest"]:
            check_tests(words[2:])
        case "python" if words[0] == "-m":
            check_module(words[1], words[2:])
        case "pip":
            check_pip(words)
        case "export":
            check_export(thing.text)
    for word in words:
        if re.search(r"\.(toml|txt|py|jpg)$", word) and not word.startswith("-"):
            assert word in MADE_BY_THE_READER or (ROOT / word).exists(), word


def check_rodeo(words: list[str], written_in_full: bool) -> None:
    """Against the commands themselves, which `--help` is made from."""
    node: Any = command.tree()
    while hasattr(node, "commands"):
        assert words, f"{node.name}: a command is missing"
        if words[0] == "--help":
            return
        assert words[0] in node.commands, f"{words[0]}: there are {sorted(node.commands)}"
        node, words = node.commands[words[0]], words[1:]
    known = {spelling: one for one in node.params for spelling in (*one.opts, *one.secondary_opts)}
    if node.context_settings.get(
        "allow_extra_args"
    ):  # `task create`: each parameter of the kind is an option
        properties = kinds_of(Site.load(LAB))[words[0]].schema["properties"]
        known |= {f"--{name.replace('_', '-')}": None for name in properties}
    given = [word.partition("=")[0] for word in words if word.startswith("-")]
    assert set(given) <= {*known, "--help"}, f"{node.name}: {given}, there are {sorted(known)}"
    if written_in_full:
        for one in node.params:
            if one.required and one.param_type_name == "option":
                assert {*one.opts, *one.secondary_opts} & set(given), f"{node.name} needs {one.opts}"


def check_make(words: list[str]) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for word in words:
        name, _, value = word.strip("[]").partition("=")
        if name == "PYTHON":
            assert "${PYTHON:-}" in (ROOT / "tools" / "setup.sh").read_text()
        elif value:
            assert f"$({name})" in (ROOT / "Makefile").read_text(), word
            assert value in ("area",) or any((ROOT / "bench").glob(f"{value}*")), word
        else:
            assert name in targets, word


def check_module(module: str, words: list[str]) -> None:
    """The options of a program are what its source hands to argparse; services share theirs."""
    path = ROOT / module.replace(".", "/")
    source = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__main__.py"
    assert source.exists(), module
    declared = source.read_text()
    if re.search(r"\bmain(_of_one)?\(", declared):
        declared += (ROOT / "rodeo" / "runtime" / "process.py").read_text()
    for word in words:
        if word.startswith("--"):
            assert f'"{word}"' in declared, f"{module} knows no {word}"


def check_tests(words: list[str]) -> None:
    for word in words:
        path, _, test = word.partition("::")
        assert not test or f"def {test}(" in (ROOT / path).read_text(), word


def check_pip(words: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for word in words:
        if found := re.fullmatch(r"(\.|.*rodeo_dao-\S+\.whl\)?)\[(\w+)\]", word):
            assert found[2] in extras


def check_export(text: str) -> None:
    """What is set for Zenoh is a configuration that Zenoh takes."""
    found = re.search(r"ZENOH_CONFIG_OVERRIDE='(.*)'", text)
    for setting in found[1].split(";") if found else []:
        key, _, value = setting.partition("=")
        zenoh.Config().insert_json5(key, value)


def test_everything_that_is_not_run_has_a_reason() -> None:
    assert all(reason(command).strip() for command in NOT_RUN)


# -- links -------------------------------------------------------------------------------------------------


def test_a_link_to_no_file_or_to_no_heading_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A page\n\n[a](#a-page) [b](page.md#a-page) [c](gone.md) [d](#gone) [e](https://gone.example)\n"
    )
    assert [broken.split(": ")[1] for broken in broken_links_of(page)] == ["gone.md", "#gone"]


def test_every_link_leads_to_a_file_and_a_heading_and_the_index_lists_every_page() -> None:
    assert broken_links() == []


def test_a_page_is_short_unless_it_is_for_reference() -> None:
    """And the front page can be read in a terminal."""
    lines = {page: page.read_text().splitlines() for page in pages()}
    long = {
        page.name: len(text)
        for page, text in lines.items()
        if len(text) > 200 and page.parent.name != "reference"
    }
    assert long == {}
    front = lines[ROOT / "README.md"]
    assert len(front) <= 150 and max(map(len, front)) <= 120
