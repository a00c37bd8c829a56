"""The parts of a robot's mind, put together for one robot of a site."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import Any

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.evidence.store import Store
from rodeo.host.stamps import set_stamp
from rodeo.judging.rulings import Rulings
from rodeo.kinds import kinds_of, providing_energy
from rodeo.lab.config import RobotConfig
from rodeo.recording.copies import Copies
from rodeo.robot.arm import Arm
from rodeo.robot.behaviour import Behaviour, Robot
from rodeo.robot.bin import SmartBin
from rodeo.robot.decisions import Decisions
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileManipulator
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Sighting
from rodeo.robot.receipts import Receipts
from rodeo.robot.recording import RecordedRobot
from rodeo.robot.ros_body import RosBody
from rodeo.robot.wrist_camera import WristCamera
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.site import topics
from rodeo.site.chance import generator
from rodeo.site.tls import bus_is_closed
from rodeo.witness.chain import Inputs
from rodeo.witness.witness import Witness
from services.robot_agent.acceptance import Acceptance
from services.robot_agent.activity import Activity, Patience
from services.robot_agent.agent import Agent, Charges, Senses, check_orders
from services.robot_agent.attempts import Attempts
from services.robot_agent.charging import Charging
from services.robot_agent.execution import Assignments, Execution, Records, Tapes
from services.robot_agent.idle import Idle
from services.robot_agent.journal import recording_of
from services.robot_agent.machine import Machine, Skills
from services.robot_agent.news import News
from services.robot_agent.offers import Offers, Turns
from services.robot_agent.orders import Order, Orders
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices
from services.robot_agent.upkeep import Care, Upkeep


class _Parts:
    """What the parts of one mind share, and what is closed with it."""

    def __init__(self, process: Process, robot: RobotConfig, closing: ExitStack) -> None:
        self.process, self.site, self.robot, self.clock = process, process.site, robot, process.clock
        self.closing = closing
        self.device = process.wait_account(f"{robot.name}-device")
        self.node = self.make_node("robot_agent")
        closing.callback(self.node.close)
        self.dao = RobotParticipant(process.bus, self.site.org, robot.name)
        item_pose = topics.ITEM_POSE
        self.item_pose = self.node.publisher(item_pose.name(ns=robot.namespace), item_pose.type)

    def make_node(self, name: str) -> Node:
        session, domain_id = self.process.bus.session, self.site.bus.domain_id
        return Node(session, name, self.robot.namespace, domain_id, self.clock)

    def make_witness(self) -> Witness:
        # The bus carries the robot's pose and what it holds.
        inputs: Inputs = "closed_bus" if bus_is_closed(self.site) else "open_bus"
        process, now_ns = self.process, self.clock.now_ns
        witness = Witness(
            process.bus, self.site.org, self.robot.name, self.device, process.data_dir, inputs, now_ns
        )
        self.closing.callback(witness.close)
        return witness

    def make_machine(self, interrupts: Interrupts) -> Machine:
        site, robot, clock = self.site, self.robot, self.clock
        body = RosBody(self.node, site, robot, clock, interrupts)
        floor, chance = Floor(site), generator(site, self.process.name, "explore")
        memory = Memory(site, self.process.data_dir / "memory.json")
        arm = Arm(robot.limits, robot.kinematics, robot.postures)
        camera = WristCamera(self.make_node, robot, body, arm, clock)
        stop = self.process.stop
        hands = MobileManipulator(site, body, arm, camera, floor, memory, clock, chance, stop)
        return Machine(robot, body, hands, floor, memory, interrupts, chance)

    def make_skills(self, machine: Machine, bins: dict[str, SmartBin], upkeep: Upkeep) -> Skills:
        """Raises KindError."""
        kinds, made = kinds_of(self.site), dict[str, Behaviour]()
        for name, kind in kinds.items():
            if (behaviour := kind.load_behaviour()) is not None:
                made[name] = behaviour(
                    Robot(
                        name=self.robot.name,
                        site=self.site,
                        body=machine.hands,
                        floor=machine.floor,
                        memory=machine.memory,
                        bins=bins,
                        clock=self.clock,
                        announce=self._announce,
                        estimate=partial(upkeep.estimate, name),
                    )
                )
        return Skills(kinds, made, upkeep, self.clock)

    def _announce(self, sighting: Sighting) -> None:
        now_ns = self.clock.now_ns()
        message = types.new(topics.ITEM_POSE.type)
        message.header.frame_id = "map"
        set_stamp(message, now_ns)
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = sighting.position_m
        turn.w, turn.x, turn.y, turn.z = sighting.quat_wxyz
        self.item_pose.publish(message, now_ns)

    def make_orders(
        self, machine: Machine, news: News, offers: Offers, activity: Activity, decisions: Decisions
    ) -> Orders:
        def on_order(order: Order) -> None:
            if order in (Order.STOP, Order.RESUME):
                # Done here, because it must not wait for the robot's work.
                machine.body.emergency_stop(order is Order.STOP)
            news.notice()

        def state() -> dict[str, Any]:
            return {"robot": self.robot.name, "rests_until": offers.rests_until, **activity.state()}

        bus, path = self.process.bus, self.process.data_dir / "orders.json"
        return Orders(bus, self.site.org, self.robot.name, path, on_order, state, decisions.about)

    def make_events(self, news: News, rulings: Rulings) -> DaoEvents:
        def on_event(event: DaoEvent) -> None:
            news.on_event(event)
            rulings.on_event(event)
            news.notice()

        events = DaoEvents(self.process.bus, self.site.org, on_event, clock=self.clock)
        self.closing.callback(events.close)
        return events


def assembled(process: Process, robot: RobotConfig, closing: ExitStack) -> Agent:
    """A robot's mind. `closing` closes what it uses."""
    parts = _Parts(process, robot, closing)
    site, bus, clock, dao = parts.site, process.bus, parts.clock, parts.dao
    news = News(clock, process.stop)
    interrupts = Interrupts(lambda: check_orders(process.stop, orders))
    machine = parts.make_machine(interrupts)
    witness = parts.make_witness()
    bins = {one.name: SmartBin(bus, site, one.name, clock, witness, interrupts) for one in site.bins}
    for one in bins.values():
        closing.callback(one.close)
    upkeep = Upkeep(site, robot, parts.node, machine.body, process.data_dir)
    activity = Activity(process, machine.body, upkeep)
    prices = Prices(site, robot, dao, upkeep, clock, process.data_dir)
    skills = parts.make_skills(machine, bins, upkeep)
    acceptance = Acceptance(site, dao, clock, skills.behaviours)
    receipts = Receipts(site, robot, witness, bus, parts.node, clock)
    closing.callback(receipts.close)
    charging = Charging(
        site, robot.name, dao, machine.body, machine.hands, clock, receipts, skills.behaviours
    )
    offers = Offers(robot, dao, skills, prices, clock)
    care = Care(site, robot.name, dao, clock, upkeep)
    idle = Idle(process, machine, news, activity, care, charging, offers)
    decisions = Decisions(process.data_dir / "decisions.jsonl")

    orders = parts.make_orders(machine, news, offers, activity, decisions)
    rulings = Rulings(dao, clock, process.stop)
    closing.callback(rulings.close)
    news.start()
    dao_events = parts.make_events(news, rulings)
    store = Store(site)
    copies = Copies(bus, site.org, robot.name, store, partial(recording_of, process.data_dir / "tasks"))
    closing.callback(copies.close)
    closing.callback(orders.close)
    assignments = Assignments(dao, dao_events, acceptance, news, orders)
    execution = Execution(process, machine, skills, upkeep, assignments, activity)
    recorded = RecordedRobot(site, robot.name, parts.device, bus, clock, interrupts)
    tapes = Tapes(recorded, dao, skills, parts.make_node)
    records = Records(process, machine, skills, execution, tapes, orders, news, activity)
    attempts = Attempts(process, dao, skills, records, offers, store, acceptance, idle)
    energy = providing_energy(site).name
    senses = Senses(process, energy, dao, skills, attempts, idle, orders, decisions)
    turns, patience = Turns(process, robot, dao, news), Patience(process, news, activity)
    return Agent(
        process, senses, attempts, idle, offers, turns, patience, Charges(charging, orders, idle, news)
    )
