"""`state/organization`, `state/proposals` and `state/budget_votes`: answers from the index."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from eth_typing import HexStr
from eth_utils import to_bytes

from rodeo.bus.queries import BudgetVoteFilters, ProposalFilters
from rodeo.bus.session import Request, validate
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.types import ZERO_ADDRESS, Role
from rodeo.chain.governance import described
from rodeo.chain.proposals import BUDGET_CREDITS, SUPPORT, WHY, shares
from rodeo.judging.verdicts import LAST_RULINGS, counted_voids
from rodeo.text.strict_json import Json
from services.bridge.chain import Chain
from services.bridge.names import ORGANIZATION, Names
from services.bridge.reading import Page

_OF_KIND = (
    "kind",
    "allowed",
    "number",
    "min_window_s",
    "max_window_s",
    "grace_s",
    "min_verdict_window_s",
    "max_verdict_window_s",
    "audit_window_s",
    "judges_window_s",
    "max_case_s",
    "rules_sha256",
    "votes",
    "panel",
    "rotation_s",
    "seats",
)


class OrganizationQueries:
    """Answers questions about rules, judges, proposals and budgets."""

    def __init__(
        self,
        chain: Chain,
        names: Names,
        client: ChainClient,
        balances: Callable[[Sequence[str]], Mapping[str, int]],
    ) -> None:
        self._index, self._deployment = chain.index, chain.deployment
        self._iec = chain.deployment.currency.text
        self._names, self._client, self._balances = names, client, balances

    def table(self) -> Mapping[str, Callable[[Request], Json]]:
        return {
            "organization": self._organization,
            "proposals": self._proposals,
            "budget_votes": self._budget_votes,
        }

    def _committee_json(self, committee: str) -> Json:
        judges, kinds = (
            self._index.rules.challenge_judges(committee),
            self._index.rules.challenge_kinds(committee),
        )
        return {
            "name": committee,
            "judges": [self._judge_json(row, self._names.name(row["key"])) for row in judges],
            "kinds": [
                {
                    **{key: row[key] for key in ("kind", "votes", "seats")},
                    "judge_stake_iec": self._iec(row["judge_stake"]),
                }
                for row in kinds
            ],
        }

    def _organization(self, _request: Request) -> Json:
        address = self._names.addresses[ORGANIZATION]
        numbers, voids = self._index.rules.numbers(), Counter[str]()
        recent = self._index.tasks.recent_voids(LAST_RULINGS)
        for by_fault in self._index.tasks.voids().values():
            voids.update(by_fault)
        return {
            "address": address,
            "treasury_iec": self._iec(self._balances([address])[address]),
            "policy": self._names.policy(self._index.rules.setting("policy") or self._client.rules.policy()),
            "kinds": [
                {
                    **{key: row[key] for key in _OF_KIND},
                    **self._names.judge_of(numbers.get(row["number"])),
                    "judge_stake_iec": self._iec(row["judge_stake"]),
                    "reference_price_iec": self._iec(row["reference_price"]),
                }
                for row in self._index.rules.all_kinds()
            ],
            "terms": self._index.rules.setting("terms")
            or {"bond_iec": "0", "penalty_iec": "0", "max_failures": 0},
            "auditors": self._names.judge(self._index.rules.setting("auditors") or ZERO_ADDRESS),
            "members_only": bool(self._index.rules.setting("members_only")),
            "suspended_providers": [
                {"address": address, "name": self._names.name(address)}
                for address, row in sorted(self._index.services.providers().items())
                if row["suspended"]
            ],
            "budgets": {
                role: budget
                for role in (Role.OPERATOR, Role.TREASURER)
                if (budget := self._index.rules.setting(f"budget {role}")) is not None and budget["period_s"]
            },
            "paused_until_s": self._index.rules.setting("paused_until_s") or 0,
            "judges": [self._judge_json(row, row["name"]) for row in self._index.rules.judges()],
            "committees": [self._committee_json(one) for one in self._deployment.committees[1:]],
            "voids": dict(voids),
            "many_voids": bool(counted_voids(*recent.get(None, (0, {})), of_a_creator=False)),
            "decided_by": "vote" if self._deployment.decides_by_vote else "administrator",
            "delay_s": self._client.decisions.delay_s() if self._deployment.has_timelock else 0,
            "roles": {
                role: [{"address": holder, "name": self._names.key_name(holder)} for holder in holders]
                for role, holders in self._index.rules.roles().items()
            },
            "contracts": self._deployment.contracts,
        }

    def _judge_json(self, row: Mapping[str, Any], name: str | None) -> Json:
        return {
            **{key: row[key] for key in ("seat", "key", "owner", "leaving_until_s")},
            "name": name,
            "owner_name": self._names.name(row["owner"]),
            "stake_iec": self._iec(row["stake"]),
            "leaving_iec": self._iec(row["leaving"]),
        }

    def _proposals(self, request: Request) -> Json:
        wanted = validate(ProposalFilters, request.parameters)
        rows, total = self._index.votes.proposals(Page(wanted.limit, wanted.offset))
        return {"proposals": [self._proposal_json(row) for row in rows], "total": total}

    def _proposal_json(self, row: Mapping[str, Any]) -> Json:
        calls = list(zip(row["targets"], row["calldatas"], strict=True))
        if not self._deployment.decides_by_vote:
            calls = [call for call in calls if call[0] != WHY]  # the description
        return {
            **{key: row[key] for key in ("number", "id", "proposer", "description")},
            "proposer_name": self._names.name(row["proposer"]),
            "calls": [
                asdict(described(self._deployment, target, to_bytes(hexstr=data))) for target, data in calls
            ],
            # What has ended stays so; the rest changes with time.
            "state": row["ended"] or self._proposal_state(row["id"]),
            "created_s": row["created"],
            "vote_end_s": row["vote_end"],
            "ready_s": row["ready"],
            "votes": {support: row[support] for support in SUPPORT},
            "ballots": [
                {
                    "voter": one["voter"],
                    "voter_name": self._names.name(one["voter"]),
                    "support": one["support"],
                    "weight": one["weight"],
                }
                for one in row["ballots"]
            ],
        }

    def _proposal_state(self, key: str) -> str:
        if self._deployment.decides_by_vote:
            return self._client.decisions.proposal_state(int(key, 16))
        return self._client.decisions.operation_state(to_bytes(hexstr=HexStr(key)))

    def _budget_votes(self, request: Request) -> Json:
        wanted = validate(BudgetVoteFilters, request.parameters)
        rows, total = self._index.votes.budget_votes(Page(wanted.limit, wanted.offset), wanted.number)
        now_s = self._client.decisions.voting_time_s() if rows else 0
        return {"budget_votes": [self._budget_vote_json(row, now_s) for row in rows], "total": total}

    def _budget_vote_json(self, row: Mapping[str, Any], now_s: int) -> Json:
        owed = shares(row["amount"], row["votes"])
        each = list(zip(row["recipients"], row["votes"], owed, row["paid"], strict=True))
        open_or_ended = "open" if now_s < row["end"] else "ended"
        is_paid = any(owed) and all(paid is not None for _, _, share, paid in each if share)
        return {
            "number": row["number"],
            "state": "paid" if is_paid else open_or_ended,
            "amount_iec": self._iec(row["amount"]),
            "opened_s": row["opened"],
            "end_s": row["end"],
            "credits": BUDGET_CREDITS,
            "recipients": [
                {
                    "address": address,
                    "name": self._names.name(address),
                    "votes": votes,
                    "share_iec": self._iec(share),
                    "paid_iec": None if paid is None else self._iec(int(paid)),
                }
                for address, votes, share, paid in each
            ],
            "ballots": [
                {
                    "voter": one["voter"],
                    "voter_name": self._names.name(one["voter"]),
                    "votes": one["votes"],
                    "credits_used": sum(votes * votes for votes in one["votes"]),
                }
                for one in row["ballots"]
            ],
        }
