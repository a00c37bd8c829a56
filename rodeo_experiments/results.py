"""The figures of a run, all from its record: `results.json`."""

from __future__ import annotations

import itertools
import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property

from rodeo.bus.messages import Task
from rodeo.bus.queries import Transaction, Transfer
from rodeo_experiments.record import Flow, Run
from rodeo_experiments.unlisted import Unlisted

STEPS = {
    "Ruled": "verdict and payment",
    "ProofSubmitted": "hand in the proof",
    "TaskRegistered": "post a task",
    "ServiceRegistered": "offer a service",
    "ServiceUpdated": "change an offer",
    "WitnessRoot": "daily root of a device",
}
"""Event -> the step of which it tells, the most telling first."""

Value = float | int | bool | str | None | list[float] | list[int]


def median(values: Iterable[float]) -> float:
    """NaN where there is none."""
    known = list(values)
    return statistics.median(known) if known else math.nan


@dataclass(frozen=True)
class Figures:
    """Everything that table, figures and `results.json` show of one run. Amounts in IEC, `_s` of wall time
    where the name has `oracle`, else of the site's."""

    run: Run

    # -- tasks -------------------------------------------------------------------------------------------

    @cached_property
    def cleanings(self) -> list[Task]:
        return self.run.of(self.run.work)

    @cached_property
    def charges(self) -> list[Task]:
        return self.run.of(self.run.energy)

    @cached_property
    def own_tasks(self) -> list[Task]:
        """Those that the paper counts: not the emptying of the bin."""
        return sorted([*self.cleanings, *self.charges], key=lambda task: task.id)

    def settled(self, tasks: Iterable[Task]) -> list[Task]:
        """Paid, in the order in which they were."""
        paid = [task for task in tasks if task.state == "settled" and task.verdict == "accepted"]
        return sorted(paid, key=lambda task: task.settled or 0.0)

    def per_day(self, tasks: Iterable[Task]) -> list[int]:
        counts = [0] * self.run.days
        for task in tasks:
            if task.settled is not None:
                counts[min(self.run.day_of(task.settled), self.run.days - 1)] += 1
        return counts

    def execution_min(self, tasks: Iterable[Task]) -> list[float]:
        """From assignment to proof, min of site time."""
        return [
            (task.proof_submitted - task.assigned) / 60
            for task in self.settled(tasks)
            if task.proof_submitted is not None and task.assigned is not None
        ]

    def oracle_s(self, tasks: Iterable[Task]) -> list[float]:
        """From proof to verdict, s of wall time."""
        ids = {task.id for task in self.settled(tasks)}
        submitted: dict[int, float] = {}
        lasted: dict[int, float] = {}
        for event in self.run.events:
            if event.task_id not in ids or event.task_id is None:
                continue
            if event.name == "ProofSubmitted":
                submitted[event.task_id] = event.wall_s
            elif event.name == "Ruled" and event.task_id in submitted:
                lasted[event.task_id] = event.wall_s - submitted[event.task_id]
        return list(lasted.values())

    def oracle_site_s(self, tasks: Iterable[Task]) -> list[float]:
        """The same, s of site time; never less than nothing, though blocks have whole seconds."""
        return [
            max(0.0, task.settled - task.proof_submitted)
            for task in self.settled(tasks)
            if task.settled is not None and task.proof_submitted is not None
        ]

    @property
    def explained(self) -> list[str]:
        """Why tasks were not paid; one sentence each."""
        return [
            f"Task {task.id} ({task.kind}) is {task.state}: {task.reason or task.verdict or 'no reason'}"
            for task in self.run.tasks
            if task.state != "settled"
        ]

    # -- money -------------------------------------------------------------------------------------------

    def address(self, name: str) -> str:
        return next(one.address for one in self.run.participants if one.name == name)

    @cached_property
    def _setup(self) -> list[Transfer]:
        """What filled the wallets before the first day."""
        return list(itertools.takewhile(lambda one: one.reason in ("mint", "deposit"), self.run.transfers))

    @cached_property
    def started_s(self) -> float:
        """Site time from which balances count. Blocks of the deployment may be seconds ahead of the clock."""
        return max([self.run.started_s, *(one.time_s for one in self._setup)])

    def balance(self, name: str, time_s: float = math.inf) -> Decimal:
        """Balance of a participant at the end of that time."""
        address, total = self.address(name), Decimal(0)
        for one in self.run.transfers:
            if one.time_s <= time_s:
                total += one.amount_iec * ((one.to == address) - (one.sender == address))
        return total

    def day_ends(self, name: str) -> list[Decimal]:
        """The balance at the end of each day."""
        ends = [self.run.begin_s + 86_400 * (day + 1) for day in range(self.run.days)]
        return [self.balance(name, end_s) for end_s in ends]

    def gains(self, name: str) -> list[Decimal]:
        """What the balance grew by on each day."""
        ends = [self.balance(name, self.started_s), *self.day_ends(name)]
        return [after - before for before, after in itertools.pairwise(ends)]

    @cached_property
    def unlisted(self) -> Unlisted:
        return Unlisted(self.run)

    @cached_property
    def charge_price(self) -> Decimal:
        return self.charges[0].reward_iec if self.charges else Decimal(200)

    def funded(self, amounts: Sequence[Decimal]) -> list[int]:
        """Charges that each amount buys."""
        return [max(0, int(amount // self.charge_price)) for amount in amounts]

    @cached_property
    def is_conserved(self) -> bool:
        """Nothing was minted or burnt on the way, and the transfers say what the wallets have."""
        minted = Decimal(self.run.supply_start_iec)
        told = all(
            self.balance(one.name) == one.balance_iec for one in self.run.participants if one.name is not None
        )
        return Decimal(self.run.supply_end_iec) == minted and told

    # -- energy ------------------------------------------------------------------------------------------

    @cached_property
    def flows(self) -> list[Flow]:
        """Charges as the docks felt them; a moment's contact is none."""
        return [flow for flow in self.run.flows if flow.energy_wh >= 1]

    @property
    def energy_kwh(self) -> float:
        return sum(flow.energy_wh for flow in self.flows) / 1000

    @property
    def cost_eur(self) -> float:
        return sum(flow.cost_eur for flow in self.flows)

    @property
    def intervals_h(self) -> list[float]:
        """From the begin of a robot's charge to that of its next, h."""
        begins: dict[str, list[float]] = defaultdict(list)
        for task in self.settled(self.charges):
            begins[task.creator].append(task.assigned or 0.0)
        return [
            (after - before) / 3600
            for times in map(sorted, begins.values())
            for before, after in itertools.pairwise(times)
        ]

    @property
    def hours_per_charge(self) -> float:
        """Operation that a mean charge's energy lasted for, at the mean power of a robot that is on, h."""
        # Of readings in which nothing flows in, and which are more than standby.
        used_w = [-one.power_w for one in self.run.battery if one.power_w < -_ON_W]
        if not used_w or not self.flows:
            return math.nan
        return statistics.mean(flow.energy_wh for flow in self.flows) / statistics.mean(used_w)

    # -- the chain ---------------------------------------------------------------------------------------

    @cached_property
    def steps(self) -> dict[str, list[Transaction]]:
        """Step -> its transactions since the experiment began."""
        found: dict[str, list[Transaction]] = defaultdict(list)
        setup = max((one.block for one in self._setup), default=-1)
        for one in self.run.transactions:
            if one.block > setup and one.gas_used is not None:
                found[step_of(one)].append(one)
        return dict(found)

    @property
    def gas_per_task(self) -> list[int]:
        """What the transactions of each paid task used together: posting, proof and verdict."""
        paid = {task.id for task in self.settled(self.own_tasks)}
        gas = {one.tx_hash: one.gas_used or 0 for one in self.run.transactions}
        used: dict[int, int] = defaultdict(int)
        for event in self.run.events:
            if event.name in ("TaskRegistered", "ProofSubmitted", "Ruled") and event.task_id in paid:
                assert event.task_id is not None
                used[event.task_id] += gas.get(event.tx_hash, 0)
        return list(used.values())

    @property
    def transaction_s(self) -> list[float]:
        """From a command to its reply, which comes when it is mined; wall time."""
        return [one.replied_s - one.sent_s for one in self.run.sent]

    @property
    def event_s(self) -> list[float]:
        """From the same command to its event here; wall time."""
        heard = {one.task_id: one.wall_s for one in self.run.events if one.name == "TaskRegistered"}
        return [heard[one.task_id] - one.sent_s for one in self.run.sent if one.task_id in heard]

    # ----------------------------------------------------------------------------------------------------

    def results(self) -> dict[str, Value]:
        """`results.json`. Balances and what they fund are the first robot's where nothing else is said."""
        run, robot = self.run, self.run.robots[0]
        cleaning_min, charging_min = self.execution_min(self.cleanings), self.execution_min(self.charges)
        settled_work = self.settled(self.cleanings)
        by_gain = self.funded(self.gains(robot))
        hours = self.hours_per_charge
        verdicts = [event.verdict for event in run.events if event.name == "Ruled"]
        found: dict[str, Value] = {
            "tasks_total": len(self.own_tasks),
            "tasks_settled": len(self.settled(self.own_tasks)),
            "tasks_rejected": verdicts.count("rejected"),
            "tasks_void": sum(task.verdict == "void" for task in run.tasks),
            "tasks_expired": sum(task.verdict == "expired" for task in run.tasks),
            "cleaning_settled": len(settled_work),
            "charging_settled": len(self.settled(self.charges)),
            "emptying_settled": len(self.settled(run.of(run.emptying))),
            "arrivals": len(run.arrivals),
            "cleanings_per_day": self.per_day(self.cleanings),
            "charges_per_day": self.per_day(self.charges),
            "cleaning_execution_min_median": median(cleaning_min),
            "cleaning_execution_min_range": [min(cleaning_min), max(cleaning_min)] if cleaning_min else [],
            "cleaning_oracle_s_median": median(self.oracle_s(self.cleanings)),
            "cleaning_oracle_min_median": median(self.oracle_site_s(self.cleanings)) / 60,
            "charging_min_median": median(charging_min),
            "charging_oracle_s_median": median(self.oracle_s(self.charges)),
            "charging_oracle_min_median": median(self.oracle_site_s(self.charges)) / 60,
            "charging_interval_h_median": median(self.intervals_h),
            "balance_start_iec": float(self.balance(robot, self.started_s)),
            "balance_end_iec": float(self.balance(robot)),
            "balance_end_iec_per_robot": [float(self.balance(one)) for one in run.robots],
            "organization_start_iec": float(self.balance("organization", self.started_s)),
            "organization_end_iec": float(self.balance("organization")),
            "supply_conserved": self.is_conserved,
            "funded_charges_per_day": by_gain,
            "funded_charges_per_day_by_balance": self.funded(self.day_ends(robot)),
            "hours_per_charge": hours,
            "funded_hours_total": sum(by_gain) * hours,
            "energy_kwh_total": self.energy_kwh,
            "eur_per_charge": self.cost_eur / len(self.flows) if self.flows else math.nan,
            "eur_per_cleaning": self.cost_eur / len(settled_work) if settled_work else math.nan,
            "gas_per_task_median": median(self.gas_per_task),
            "transaction_s_median": median(self.transaction_s),
            "event_s_median": median(self.event_s),
            "site_realtime_factor": run.site_s / run.wall_s,
            "clock_wait_share": run.waited_s / run.wall_s,
            "wall_s": run.wall_s,
            "seed": run.seed,
        }
        if run.things:
            found |= _of_things(self.unlisted)
        return {name: _plain(value) for name, value in found.items()}

    def problems(self, arrivals: int) -> list[str]:
        """Why this run is no success; empty when it is one."""
        found = []
        posted = sum(one.task_id is not None for one in self.run.arrivals)
        if posted != arrivals:
            found.append(f"{posted} of {arrivals} arrivals were posted")
        live = [task.id for task in self.run.tasks if task.state not in ("settled", "cancelled", "failed")]
        if live:
            found.append(f"tasks {live} are not over")
        if not self.is_conserved:
            found.append("the supply of IEC changed")
        return found


_ON_W = 10.0
"""A robot that is on draws more than this, one that is off less."""


def _of_things(every: Unlisted) -> dict[str, Value]:
    return {
        "things_found_by_robots": len(every.found),
        "things_pointed_at": len(every.pointed),
        "things_in_bin": len(every.fallen),
        "tasks_about_nothing": every.about_nothing,
        "things_class_known": sum(one.is_known for one in every.fallen),
        "things_scale_off_g_median": median(one.off_g for one in every.fallen),
        "things_posted_min_median": median(one.posted_min for one in (*every.found, *every.pointed)),
        "things_in_bin_min_median": median(one.in_bin_min for one in every.fallen),
    }


def step_of(transaction: Transaction) -> str:
    """What the transaction was for."""
    for event, step in STEPS.items():
        if event in transaction.events:
            return step
    return "others"


def _plain(value: Value) -> Value:
    """As JSON has it: no NaN, and no more digits than mean something."""
    if isinstance(value, bool | str) or value is None:
        return value
    if isinstance(value, list):
        return [_plain(one) for one in value]  # type: ignore[return-value]
    if isinstance(value, int):
        return value
    return None if math.isnan(value) else round(value, 4)
