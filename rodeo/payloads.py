"""The payloads of the DAO plane, from the models: `python -m rodeo.payloads > docs/reference/keys.md`."""

from __future__ import annotations

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Mapping
from functools import cache
from typing import Any

from pydantic import BaseModel

from rodeo import kinds
from rodeo.bus import queries
from rodeo.bus.messages import (
    Broadcast,
    ClockHold,
    ClockMark,
    DaoEvent,
    Dispute,
    Prepare,
    SealedVote,
    SignedRequest,
    SignedVote,
    Standing,
    Status,
    Task,
    Vote,
)
from rodeo.bus.seen import Saying, SeenId, SightReport
from rodeo.commands import COMMANDS, Command
from rodeo.commands.declare import example_of
from rodeo.commands.examples import ADDRESS, BEFORE, DIGEST, OTHER, PREPARE, SIGN, SIGNED, VOTE
from rodeo.commands.judging import SignVote
from rodeo.commands.relaying import Sign
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.seal import Binding, SealHead
from rodeo.site import topics
from rodeo.site.topics import markdown
from rodeo.witness.correction import Correction, Judged, Pictured
from rodeo.witness.statement import (
    Claimant,
    Classification,
    Drop,
    Head,
    Header,
    MeterRecord,
    Motion,
    Presentation,
    Receipt,
    Removal,
    Watch,
)

STATEMENTS: tuple[type[Header], ...] = (
    Motion,
    Classification,
    Drop,
    Removal,
    Watch,
    Presentation,
    MeterRecord,
    Receipt,
)

_TASK = {
    "id": 7,
    "kind": "window_cleaning",
    "state": "assigned",
    "attempt": 1,
    "max_attempts": 3,
    "creator": OTHER,
    "creator_name": "organization",
    "executor": ADDRESS,
    "executor_name": "panther1",
    "service_id": 2,
    "reward_iec": "100",
    "price_iec": "100",
    "paid_iec": "0",
    "params": {"window": "north"},
    "description": "",
    "registered": 1795320000.0,
    "assigned": 1795320001.0,
    "execution_deadline": 1795327201.0,
    "execution_window_s": 7200,
    "grace_s": 180,
    "verdict_window_s": 172800,
    "nonce": DIGEST,
}
_CLAIMANT = {"device": "panther1", "address": ADDRESS, "recording": DIGEST, "task_id": 7, "attempt": 1}
_HEAD = {"device": "panther1", "address": ADDRESS, "chain": DIGEST, "index": 12, "digest": BEFORE}
_CHAIN = {"chain_id": 31337, "task_manager": OTHER, "organization": ADDRESS}
_HEADER = {
    **_CHAIN,
    "seq": 42,
    "previous": BEFORE,
    "time_s": 1795320100.2,
    "heads": [_HEAD],
    "inputs": "closed_bus",
}
_BIN = {"device": "itrash", "claimants": [_CLAIMANT]}
_FELL = {"compartment": "yellow", "weight_n": 0.294, "after_s": 1795320120.4, "settled_s": 1795320121.1}
_CHARGE = {"task_id": 8, "attempt": 1, "recording": DIGEST, "begin_wh": 12345.0, "register_wh": 12347.5}

_SIGHT_REPORT = {
    "kind": "window_cleaning",
    "x_m": 3.2,
    "y_m": 1.4,
    "size_m": [0.12, 0.07, 0.07],
    "photo": f"{DIGEST[2:]}.jpg",
}
_SAID = {"who": "olivia", "what": "metal", "said_s": 1795320100.0}

EXAMPLES: dict[type[BaseModel], dict[str, Any]] = {
    Attestation: {"payload": {"type": "bin.removal"}, "signer": ADDRESS, "signature": "0x" + "5b" * 65},
    Head: _HEAD,
    Claimant: _CLAIMANT,
    Binding: {
        **_CHAIN,
        "device": "panther1",
        "task_id": 7,
        "attempt": 1,
        "executor": ADDRESS,
        "nonce": DIGEST,
    },
    SealHead: {
        "type": "recording.seal",
        "version": 1,
        **_CHAIN,
        "device": "panther1",
        "recording": DIGEST[2:],
        "index": 12,
        "messages": 1904,
        "hash": BEFORE[2:],
        "previous": "6a" * 32,
        "time_ns": "1795320100200000000",
    },
    Motion: {
        **_HEADER,
        "type": "mocap.motion",
        "device": "mocap",
        "start_us": 1795320099200000,
        "end_us": 1795320100200000,
        "tracks": {},
        "resting": {"item1": 3},
    },
    Classification: {
        **_HEADER,
        **_BIN,
        "type": "bin.classification",
        "number": 5,
        "class": "metal",
        "probabilities": {"metal": 0.98, "glass": 0.02},
        "compartment": "yellow",
        "full": False,
        "image_sha256": DIGEST,
        "model_sha256": BEFORE,
        "thresholds_sha256": DIGEST,
        "shown_s": 1795320100.0,
    },
    Drop: {
        **_HEADER,
        **_BIN,
        **_FELL,
        "type": "bin.drop",
        "number": 4,
        "classification": 5,
        "expected_compartment": "yellow",
        "correct": True,
    },
    Correction: {
        **_CHAIN,
        "type": "bin.correction",
        "bin": "itrash",
        "image_sha256": DIGEST,
        "class": "glass",
    },
    Judged: {"address": OTHER, "name": "anna", "items": 9, "right": 7},
    Pictured: {
        "image_sha256": DIGEST,
        "class": "metal",
        "shown_s": 1767225600.0,
        "corrections": {"anna": "glass"},
    },
    Removal: {**_HEADER, **_FELL, "type": "bin.removal", "device": "itrash"},
    Watch: {
        **_HEADER,
        "type": "bin.watch",
        "device": "itrash",
        "drop": 7,
        "compartment": "yellow",
        "after_s": 1767225600.0,
        "until_s": 1767225614.0,
    },
    Presentation: {
        **_HEADER,
        "type": "robot.presentation",
        "device": "panther1",
        "bin": "itrash",
        "recording": DIGEST,
        "task_id": 7,
        "attempt": 1,
        "grasped_s": 1767225580.0,
    },
    MeterRecord: {
        **_HEADER,
        **_CHARGE,
        "type": "meter.record",
        "device": "dock1",
        "robot": "panther1",
        "page": 2,
        "reason": "step",
        "contactor": "closed",
        "until_s": 1795320100.0,
        "since_ms": 1795320099000,
        "readings": "",
        "soc": 0.41,
        "ocmf": "OCMF|{}|{}",
    },
    Receipt: {
        **_HEADER,
        **_CHARGE,
        "type": "robot.receipt",
        "device": "panther1",
        "meter": "dock1",
        "meter_address": OTHER,
        "record": DIGEST,
        "soc": 0.41,
        "reason": "step",
    },
    Task: {name: _TASK.get(name) for name in Task.model_fields}
    | {"passed": [], "refunded_iec": "0", "judge": "oracle", "judge_removed": False, "passed_on": False},
    DaoEvent: {
        "seq": 31,
        "name": "TaskAssigned",
        "block": 118,
        "log_index": 2,
        "tx_hash": DIGEST,
        "time_s": 1795320001.0,
        "task_id": 7,
        "args": {"task_id": 7, "service_id": 2, "attempt": 1},
        "chain": BEFORE,
    },
    Standing: {"ruling": "accepted", "fault": "nobody", "amount_iec": "100", "until": 1795327201.0},
    Dispute: {
        "instance": 0,
        "until": 1795327201.0,
        "challenger": OTHER,
        "stake_iec": "50",
        "because": "the item lies beside the bin",
    },
    Vote: VOTE,
    SealedVote: {"task_id": 7, "attempt": 1, "signature": "0x" + "5b" * 64},
    SignedVote: {
        "vote": VOTE,
        "report_uri": "https://store.example/" + "4c" * 32 + ".json",
        "signature": "0x" + "5b" * 64,
    },
    SightReport: _SIGHT_REPORT,
    SeenId: {"id": 3},
    Saying: {"id": 3, "what": "metal"},
    queries.Said: _SAID,
    queries.SeenThing: {
        "id": 3,
        **_SIGHT_REPORT,
        "robot": "panther1",
        "first_s": 1795320000.0,
        "last_s": 1795320100.0,
        "state": "open",
        "task_id": None,
        "said": [_SAID],
    },
    Status: {
        "process": "itrash",
        "pid": 4711,
        "ready": False,
        "reason": "no readings from itrash/presence",
        "activity": "idle",
        "progress": None,
        "since_s": 1795320000.0,
        "time_s": 1795320100.0,
    },
    ClockMark: {"number": 17},
    ClockHold: {
        "heard": 17,
        "busy": False,
        "until_ns": 1795320100200000000,
        "works": 5,
        "resting": False,
    },
    Prepare: PREPARE,
    Sign: SIGN,
    Broadcast: {"raw": "0x02f8b2", "request_id": "cancel-7", "content_sha256": "7a" * 32},
}
"""Examples of what is no command."""

_PARAMETERS: dict[str, dict[str, Any]] = {
    "tasks": {"state": "open,assigned", "limit": 10},
    "services": {"kind": "window_cleaning"},
    "wallet": {"account": "panther1"},
    "transfers": {"account": "panther1", "limit": 10},
    "transactions": {"task_id": 7},
    "history": {"bucket_s": 3600},
    "seen": {"state": "open"},
    "roots": {"limit": 10},
    "events": {"after": 31},
}


def parameters_of(what: str) -> dict[str, Any]:
    """Parameters with which the question `what` may be asked."""
    return _PARAMETERS.get(what, {})


def keys_page() -> str:
    """The text of docs/reference/keys.md: the table of keys, then the payloads."""
    return markdown() + _payloads()


def _payloads() -> str:
    """Markdown: the fields of every payload, and an example of each."""
    parts = [
        "## Payloads",
        "",
        "Payloads are UTF-8 JSON objects. Amounts are decimal strings of IEC, and times are seconds of site",
        "time. Unknown fields are an error. A query that fails gets an error reply",
        '`{"code": ..., "message": ..., "details": {}}`.',
        "",
        "### Commands",
        "",
        f"The bridge answers `{topics.COMMAND.key}` when the transaction is mined, for",
        'example with `{"tx_hash": "0x...", "block": 118, "task_id": 7}`. The answer contains the number of',
        "a new task or service. Every command may contain:",
        "",
        *_table(Command),
        "",
    ]
    for name, command in COMMANDS.items():
        parts += _section(name, command, example_of(command), without=Command)
    parts += ["The next sections list the `params` of a task, for each kind that comes with RODEO:", ""]
    for name in kinds.installed():
        kind = kinds.load(name)
        if kind.params is not None:
            parts += _section(name, kind.params, dict(kind.example))
    parts += ["If the bridge does not have a wallet's key, the owner signs elsewhere:", ""]
    parts += _section("prepare", Prepare, EXAMPLES[Prepare])
    parts += _section("broadcast", Broadcast, EXAMPLES[Broadcast])
    parts += [
        "A participant without gas money signs, and another one sends it with `relay`. The answer to `sign`",
        "is a SignedRequest:",
        "",
    ]
    parts += _section("sign", Sign, EXAMPLES[Sign])
    parts += _section("SignedRequest", SignedRequest, SIGNED)
    parts += [
        "A judge who decides about a challenge signs a vote for `post_votes`. The answer is a SignedVote:",
        "",
    ]
    parts += _section("sign_vote", SignVote, {"task_id": 7, "ruling": "rejected"})
    parts += ["### Queries", ""]
    parts += [
        f"The key is `{topics.STATE.key}`, with parameters in the selector: `?name=value;name=value`.",
        "",
    ]
    for what, query in queries.QUERIES.items():
        parts += [f"#### {what}", "", f"{query.meaning[:1].upper()}{query.meaning[1:]}.", ""]
        if query.parameters is not queries.Nothing:
            parts += [*_table(query.parameters), ""]
        selector = ";".join(f"{name}={value}" for name, value in parameters_of(what).items())
        shown = topics.STATE.name(org="lab", what=what.format(id=7)) + (f"?{selector}" if selector else "")
        fields = "those of Task" if query is queries.TASK else _fields(query.answer)
        parts += [f"    {shown}", "", f"Fields of the answer: {fields}.", ""]
    for title, about, models in _GROUPS:
        parts += [f"### {title}", "", *textwrap.wrap(about, 116), ""]
        for one in models:
            without = Header if issubclass(one, Header) and one is not Header else None
            parts += _section(one.__name__, one, EXAMPLES.get(one), without=without)
    return "\n".join(parts).rstrip() + "\n"


_GROUPS: tuple[tuple[str, str, tuple[type[BaseModel], ...]], ...] = (
    (
        "Tasks and events",
        f"`state/tasks` and `state/task/{{id}}` answer with Task. `{topics.EVENT.key}` publishes DaoEvent.",
        (Task, Standing, Dispute, DaoEvent),
    ),
    (
        "What devices sign",
        f"On `{topics.WITNESS_STATEMENT.key}`, each statement is the `payload` of an Attestation. "
        "`.../statements?after=SEQ;limit=N` answers with `device` and a list `statements`. A statement has "
        "the fields of Header and those of its own type. The signature covers the payload's canonical JSON "
        "(RFC 8785).",
        (Attestation, Header, Head, *STATEMENTS, Claimant),
    ),
    (
        "Seals",
        f"On `{topics.SEAL.key}`, the `payload` of an Attestation is a SealHead. The opening seal "
        "contains the binding of its recording.",
        (SealHead, Binding),
    ),
    (
        "What several oracles sign",
        f"On `{topics.VOTE.key}`, where a site has several oracles, is a SealedVote. The signature is "
        "EIP-712's, over the Finding of the contract OracleCommittee that the Vote says, in 64 bytes "
        "(EIP-2098). `post_votes` takes enough of them. The people who judge a dispute give each other a "
        "SignedVote.",
        (SealedVote, SignedVote, Vote),
    ),
    (
        "The bin",
        f"`{topics.BIN_STATE.key}` answers with `bin`, `state`, `since_s`, `pending`, `presented`, "
        "`loads_n` and `fill`. `classification` and `disposal` are its last attestations, null "
        f"before the first one. `{topics.BIN_PICTURE.key}?sha256=0x...` answers with `sha256` and "
        f"`data_base64`. `{topics.BIN_CORRECTIONS.key}` takes an Attestation whose `payload` is a "
        "Correction, or nothing, and answers with `bin`, a list `people` of Judged and a list `pictures` of "
        "Pictured.",
        (Correction, Judged, Pictured),
    ),
    (
        "Orders to a robot",
        f"`{topics.ROBOT_ORDER.key}`: `pause`, `resume`, `charge`, `cancel` and `stop` take an empty "
        "payload. They and `state` answer with `paused`, `stopped`, `charge_ordered`, `robot`, `task_id`, "
        "`attempt`, `activity`, `driven_km`, `working_w` and, if they are known, `progress`, `eta_s`, "
        "`soc` and `docked`.",
        (),
    ),
    (
        "What robots see on the floor",
        f"`{topics.SIGHT.key}`: a robot sends a SightReport to `report` and a SeenId to `gone`, both in its "
        "own name, and a person a Saying to `say`. The answer is the SeenThing. The bridge also publishes "
        f"it, on `{topics.SEEN.key}`, when it changes.",
        (SightReport, SeenId, Saying, queries.SeenThing, queries.Said),
    ),
    (
        "Heartbeats",
        f"Each process publishes `{topics.STATUS.key}` every second, and also answers queries on this key.",
        (Status,),
    ),
    (
        "Holders of the simulator's clock",
        f"The keys are `{topics.CLOCK_MARK.key}`, `{topics.BODY_MARK.key}` and `{topics.CLOCK_HOLD.key}`. "
        "The last one is a liveliness token, too. The clock does not wait for a process that never publishes "
        "its state, such as a real device.",
        (ClockMark, ClockHold),
    ),
)


def _section(
    title: str, model: type[BaseModel], example: dict[str, Any] | None, without: type[BaseModel] | None = None
) -> list[str]:
    text = inspect.cleandoc(model.__dict__.get("__doc__") or "")
    if not issubclass(model, Command):
        text = text.split("\n\n")[0]
    parts = [f"#### {title}", "", *([*text.split("\n"), ""] if text else [])]
    table = _table(model, without)
    if len(table) > 2:
        parts += [*table, ""]
    if example is not None:
        parts += ["```json", json.dumps(example, indent=2), "```", ""]
    return parts


def _fields(model: type[BaseModel]) -> str:
    return ", ".join(f"`{field.alias or name}`" for name, field in model.model_fields.items())


def _table(model: type[BaseModel], without: type[BaseModel] | None = None) -> list[str]:
    """A row for each field that is not one of `without`."""
    schema = model.model_json_schema(by_alias=True, mode="validation")
    inherited = set() if without is None else set(without.model_fields)
    known = meanings(model)
    rows = ["| field | JSON | needed | what |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        if name in inherited:
            continue
        alias = field.alias or name
        shape = _shape(schema["properties"][alias], schema.get("$defs", {}))
        needed = "yes" if field.is_required() else ""
        rows.append(f"| `{alias}` | {shape} | {needed} | {field.description or known.get(name, '')} |")
    return rows


def _shape(schema: dict[str, Any], defs: dict[str, Any]) -> str:
    """What JSON a field takes, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return name if defs[name].get("type") == "object" else _shape(defs[name], defs)
    if "anyOf" in schema:
        shapes = [_shape(one, defs) for one in schema["anyOf"]]
        if "string" in " ".join(shapes) and "number" in shapes:  # how pydantic takes decimals
            shapes = ["decimal string", *(["null"] if "null" in shapes else [])]
        return " or ".join(dict.fromkeys(shapes))
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{one}`" for one in schema["enum"])
    kind = schema.get("type", "any")
    if kind == "array":
        return f"list of {_shape(schema.get('items', {}), defs)}"
    return str(kind)


@cache
def meanings(model: type[BaseModel]) -> Mapping[str, str]:
    """The text under each field in the source, of a model and those that it extends."""
    found = {}
    for cls in reversed(model.__mro__):
        if not (issubclass(cls, BaseModel) and cls.__module__.startswith("rodeo")):
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        assert isinstance(body, ast.ClassDef)
        for line, after in zip(body.body, body.body[1:], strict=False):
            match line, after:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[name] = " ".join(text.split()).replace("|", "\\|")
    return found


if __name__ == "__main__":
    sys.stdout.write(keys_page())
