"""An item that the gripper bears is followed without steps; what it does not bear is stepped, and falls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rodeo.checks.case import Case
from rodeo.checks.motion import grip
from rodeo.checks.motion.kinematics import kinematics_of
from rodeo.checks.motion.replay import Motion, Perturbation, Replay, World, compartment_at, replay_of
from rodeo.checks.verify import case_of
from rodeo.evidence.proof import open_proof
from rodeo.lab.body import joint_names
from rodeo.lab.world import arm_model
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Sample, Take, seal
from tests.unit.conftest import Judge, failed

pytestmark = pytest.mark.long

JOINT_STATES = "panther1/joint_states"
GRIPPER_STATE = "panther1/gripper_controller/controller_state"
JOINTS = joint_names(arm_model())
FINGERS = [JOINTS.index("left_finger"), JOINTS.index("right_finger")]
STEP_S = 0.002
EXACT = Perturbation()


@pytest.fixture(scope="module")
def driven(site: Site) -> Take:
    """The robot drives with the item while its arm sways."""
    return film_cleaning(site, "item1", sway_rad=0.1)


@pytest.fixture(scope="module")
def case(site: Site, driven: Take, tmp_path_factory: pytest.TempPathFactory) -> Case:
    path = tmp_path_factory.mktemp("driven") / "proof.mcap"
    return case_of(
        open_proof(seal(driven, path, BINDING, ROBOT).path),
        site,
        cleaning_chain_record(driven),
    )


@pytest.fixture
def stepped(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """How many steps were taken since the test began."""
    taken = []
    step = World._step

    def count(self: World, way: grip.Way, steps: slice, state: np.ndarray) -> grip.Rows:
        taken.append(steps.stop - steps.start)
        return step(self, way, steps, state)

    monkeypatch.setattr(World, "_step", count)
    return lambda: sum(taken)


def middle(motion: Motion, seconds: float) -> slice:
    """So long about the middle of the carry."""
    at = len(motion.time_s) // 2
    half = round(seconds / STEP_S / 2)
    return slice(at - half, at + half)


def shaken(motion: Motion, rows: slice, m_s2: float, hz: float = 5.0) -> Motion:
    """The hand goes up and down there, with so much at worst."""
    position_m = motion.hand.position_m.copy()
    turn = 2 * np.pi * hz * STEP_S * np.arange(rows.stop - rows.start)
    fade = np.clip(np.minimum(turn, turn[::-1]) / (4 * np.pi), 0, 1)
    position_m[rows, 2] += fade * m_s2 / (2 * np.pi * hz) ** 2 * np.sin(turn)
    return replace(motion, hand=replace(motion.hand, position_m=position_m))


def weakened(motion: Motion, rows: slice, effort_n: float) -> Motion:
    """The fingers press with this there, and where the item lets them be."""
    effort = motion.effort_n.copy()
    effort[rows] = np.sign(effort[rows]) * effort_n
    return replace(motion, effort_n=effort)


def falls(found: Replay, motion: Motion) -> bool:
    """Whether it is let go of before the recording does."""
    return found.release_s < motion.time_s[-1] - 5.0


def test_most_of_an_honest_carry_is_not_stepped(case: Case, stepped: Callable[[], int]) -> None:
    motion = replay_of(case).motion
    found = replay_of(case).world.run(motion, EXACT)
    assert not falls(found, motion)
    assert stepped() < 0.4 * len(motion.time_s)


def test_it_ends_where_every_step_has_it(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    followed = replay_of(case)
    monkeypatch.setattr(grip, "_SPARE", 0.0)
    whole = followed.world.run(followed.motion, EXACT)
    before = followed.time_s < followed.release_s
    assert np.abs(followed.item_m - whole.item_m)[before].max() < 0.002
    assert followed.release_s == pytest.approx(whole.release_s, abs=0.04)
    assert compartment_at(case, followed.item_m[-1]) == compartment_at(case, whole.item_m[-1]) == "yellow"


def test_the_same_recording_gives_the_same_bytes(case: Case) -> None:
    again = replay_of(case).world.run(replay_of(case).motion, EXACT)
    assert np.array_equal(again.item_m, replay_of(case).item_m)
    assert np.array_equal(again.states, replay_of(case).states)


@pytest.mark.parametrize(
    ("effort_n", "shake_m_s2", "lost"),
    [
        (0.0, 0.0, True),
        (0.1, 0.0, False),
        (0.1, 10.0, True),
        (0.3, 20.0, False),
        (0.3, 40.0, True),
        (1.0, 40.0, False),
        (1.0, 80.0, True),
        (2.0, 80.0, False),
    ],
)
def test_a_weak_grip_loses_in_a_shake_what_every_step_has_it_lose(
    case: Case, monkeypatch: pytest.MonkeyPatch, effort_n: float, shake_m_s2: float, lost: bool
) -> None:
    motion, world = replay_of(case).motion, replay_of(case).world
    rows = middle(motion, 3.0)
    rough = shaken(weakened(motion, rows, effort_n), rows, shake_m_s2)
    assert falls(world.run(rough, EXACT), motion) == lost
    monkeypatch.setattr(grip, "_SPARE", 0.0)
    assert falls(world.run(rough, EXACT), motion) == lost


def test_a_grip_that_fails_again_and_again_costs_little_more_than_steps(
    case: Case, stepped: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grip, "_SPARE", 0.0)
    asked = []
    carry = grip.Grip.carry

    def count(self: grip.Grip, way: grip.Way, steps: slice, state: np.ndarray, pressed_n: float) -> grip.Rows:
        asked.append((steps.stop - steps.start) / grip.EVERY)
        return carry(self, way, steps, state, pressed_n)

    monkeypatch.setattr(grip.Grip, "carry", count)
    replay_of(case).world.run(replay_of(case).motion, EXACT)
    assert 0 < sum(asked) <= stepped() / grip.EVERY


def test_the_hand_is_where_mujoco_has_it(case: Case) -> None:
    model, data = kinematics_of(case)._model, kinematics_of(case)._data
    hand = model.body("panther1/gripper_link").id
    paths = kinematics_of(case).hand(kinematics_of(case).time_s)
    for row in range(0, len(kinematics_of(case).time_s), 50):
        data.qpos[:] = kinematics_of(case)._rows[row]
        mujoco.mj_kinematics(model, data)
        assert paths.position_m[row] == pytest.approx(data.xpos[hand], abs=1e-12)
        assert abs(paths.quaternion[row] @ data.xquat[hand]) == pytest.approx(1.0, abs=1e-12)


def between(take: Take, begin_s: float, end_s: float, topic: str, edit: Callable[[Sample], Sample]) -> Take:
    return take.edited(topic, lambda s: edit(s) if begin_s < s.time_ns * 1e-9 < end_s else s)


def test_fingers_that_stop_pressing_on_the_way_are_refused(driven: Take, judge: Judge) -> None:
    """For three seconds; the item is there before and afterwards."""

    def limp(sample: Sample) -> Sample:
        effort = sample.message.effort.copy()
        effort[FINGERS] = 0.0
        return replace(sample, message=replace(sample.message, effort=effort))

    half_s = (driven.start_s + driven.end_s) / 2
    take = between(driven, half_s, half_s + 3.0, JOINT_STATES, limp)
    assert failed(judge(take, cleaning_chain_record(take))) in ("transport", "motion_capture", "compartment")


def test_a_gripper_that_opens_for_half_a_second_on_the_way_is_refused(driven: Take, judge: Judge) -> None:
    wide = np.array([0.057, -0.057])

    def opened(sample: Sample) -> Sample:
        position, effort = sample.message.position.copy(), sample.message.effort.copy()
        position[FINGERS], effort[FINGERS] = wide, 0.0
        return replace(sample, message=replace(sample.message, position=position, effort=effort))

    def commanded(sample: Sample) -> Sample:
        reference = replace(sample.message.reference, positions=wide)
        return replace(sample, message=replace(sample.message, reference=reference))

    half_s = (driven.start_s + driven.end_s) / 2
    take = between(driven, half_s, half_s + 0.5, JOINT_STATES, opened)
    take = between(take, half_s, half_s + 0.5, GRIPPER_STATE, commanded)
    assert failed(judge(take, cleaning_chain_record(take))) in ("transport", "motion_capture", "compartment")
