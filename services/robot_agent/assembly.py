"""The parts of a robot's mind, put together for one robot of a site."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import Any, cast

from rodeo.attempts.device import RobotDevice
from rodeo.attempts.events import TaskEvents
from rodeo.bus.messages import DaoEvent
from rodeo.bus.seen import Seen
from rodeo.bus.session import DaoEvents
from rodeo.host.stamps import set_stamp
from rodeo.judging.rulings import Rulings
from rodeo.kinds import kinds_of, providing_energy
from rodeo.lab.config import RobotConfig
from rodeo.recording.pace import LEAST_WORK_S
from rodeo.robot.arm import Arm
from rodeo.robot.behaviour import Behaviour, Robot
from rodeo.robot.bin import SmartBin
from rodeo.robot.body import Body
from rodeo.robot.decisions import Decisions
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileBase, MobileManipulator
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Sighting
from rodeo.robot.receipts import Receipts
from rodeo.robot.ros_body import RosBody
from rodeo.robot.wrist_camera import WristCamera
from rodeo.ros2 import types
from rodeo.runtime.process import Process
from rodeo.site import topics
from rodeo.site.chance import generator
from rodeo.site.sections import interface_of
from services.robot_agent.acceptance import Acceptance
from services.robot_agent.activity import Activity, Patience
from services.robot_agent.agent import Agent, Charges, Senses, check_orders
from services.robot_agent.attempts import Attempts
from services.robot_agent.charging import Charging
from services.robot_agent.execution import Assignments, Execution, Records
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Machine, Skills, is_equipped
from services.robot_agent.news import News
from services.robot_agent.offers import Offers, Turns
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices
from services.robot_agent.upkeep import Care, Upkeep


class _Parts(RobotDevice):
    """Makes the parts of one mind, which also has the key of the robot's device."""

    def __init__(self, process: Process, robot: RobotConfig, closing: ExitStack) -> None:
        super().__init__(process, robot, "robot_agent", closing)
        self.dao = RobotParticipant(process.bus, self.site.org, robot.name)
        item_pose = topics.ITEM_POSE
        self.item_pose = self.node.publisher(item_pose.name(ns=robot.namespace), item_pose.type)

    def make_machine(self, interrupts: Interrupts) -> Machine:
        site, robot, clock = self.site, self.robot, self.clock
        body = RosBody(self.node, site, robot, clock, interrupts, self.offset)
        floor, chance = Floor(site), generator(site, self.process.name, "explore")
        memory, stop = Memory(site, self.process.data_dir / "memory.json"), self.process.stop
        hands: MobileBase | MobileManipulator = MobileBase(body, floor, memory, clock, chance, stop)
        if interface_of(robot).arm:
            arm = Arm(robot.limits, robot.kinematics, robot.postures)
            camera = WristCamera(self.make_node, robot, body, arm, clock)
            hands = MobileManipulator(body, arm, camera, floor, memory, clock, chance, stop)
        return Machine(robot, body, hands, floor, memory, interrupts, chance)

    def make_skills(self, machine: Machine, bins: dict[str, SmartBin], upkeep: Upkeep) -> Skills:
        """Raises KindError."""
        kinds, made = kinds_of(self.site), dict[str, Behaviour]()
        for name, kind in kinds.items():
            behaviour = kind.load_behaviour()
            if behaviour is not None and is_equipped(self.robot, behaviour):
                made[name] = behaviour(
                    Robot(
                        name=self.robot.name,
                        site=self.site,
                        body=cast(Body, machine.hands),  # work that needs an arm is left out where none is
                        floor=machine.floor,
                        memory=machine.memory,
                        bins=bins,
                        clock=self.clock,
                        announce=self._announce,
                        estimate=partial(upkeep.estimate, name),
                        seen=Seen(self.process.bus, self.site.org, self.robot.name),
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

    def make_events(self, news: News, recorded: TaskEvents, rulings: Rulings) -> DaoEvents:
        def on_event(event: DaoEvent) -> None:
            recorded.on_event(event)
            rulings.on_event(event)
            news.on_event(event)

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
    bins = parts.make_bins(witness, interrupts)
    upkeep = Upkeep(site, robot, parts.node, machine.body, process.data_dir)
    activity = Activity(process, machine.body, upkeep)
    prices = Prices(site, robot, dao, upkeep, clock, process.data_dir)
    skills = parts.make_skills(machine, bins, upkeep)

    def unfit(work_s: float = LEAST_WORK_S) -> str:
        return process.clock_check.problem or machine.body.unfit(work_s)

    acceptance = Acceptance(site, dao, clock, skills.behaviours, unfit)
    receipts = Receipts(site, robot, witness, bus, parts.node, clock)
    closing.callback(receipts.close)
    charging = Charging(
        site, robot.name, dao, machine.body, machine.hands, clock, receipts, skills.behaviours
    )
    offers = Offers(robot, dao, skills, prices, clock)
    care = Care(site, robot.name, dao, clock, upkeep)
    idle = Idle(process, machine, news, activity, care, charging, offers, skills)
    decisions = Decisions(process.data_dir / "decisions.jsonl")

    def state() -> dict[str, Any]:
        return {"rests_until": offers.rests_until, **activity.state()}

    orders = parts.make_orders(machine.body, news.wake.set, state, decisions.about)
    rulings = Rulings(dao, clock, process.stop)
    closing.callback(rulings.close)
    news.start()
    events = TaskEvents()
    dao_events = parts.make_events(news, events, rulings)
    room = parts.make_room(dao, skills.kinds, events, interrupts)
    closing.callback(orders.close)
    assignments = Assignments(dao, dao_events, acceptance, news, orders)
    execution = Execution(process, machine, skills, upkeep, assignments, activity)
    records = Records(process, machine, skills, execution, room, orders, activity)
    attempts = Attempts(process, dao, skills, records, offers, room, acceptance, idle)
    energy = providing_energy(site).name
    senses = Senses(process, energy, dao, skills, attempts, idle, orders, decisions)
    turns, patience = Turns(process, robot, dao, news), Patience(process, news, activity)
    return Agent(
        process, senses, attempts, idle, offers, turns, patience, Charges(charging, orders, idle, news)
    )
