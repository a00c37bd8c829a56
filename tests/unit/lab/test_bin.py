"""The bin's scales: each reads all that its compartment holds and nothing of what happens beside it."""

import mujoco
import numpy as np
import pytest

from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import begin, build_world, scale_weight_n
from rodeo.site.config import Site
from tests.support.site import LAB

GRAVITY = 9.81


class Bin:
    """The lab's bin with these things standing by, to be dropped into it."""

    def __init__(self, things: list[tuple[ItemClass, str, float]]) -> None:
        site = Site.load(LAB)
        items = [
            ItemConfig(
                id=f"item{k}", item_class=c, shape=s, mass_kg=m, pose=Pose2(x_m=2.5 + 0.3 * k, y_m=1.0)
            )
            for k, (c, s, m) in enumerate(things)
        ]
        self.site = site.model_copy(update={"items": items})
        self.layout = BinLayout(self.site.bins[0])
        self.model = build_world(self.site)
        self.data = begin(self.model, self.site)

    def place(self, item: str, point: np.ndarray, axis: np.ndarray) -> None:
        """Put an item there at rest, its z axis along `axis`."""
        joint = self.data.joint(item)
        quat = np.empty(4)
        mujoco.mju_quatZ2Vec(quat, axis / np.linalg.norm(axis))
        joint.qpos[:], joint.qvel[:] = [*point, *quat], 0.0

    def drop(
        self, item: str, compartment: str, aside_m: float = 0.0, axis: tuple[float, ...] = (1, 0, 0)
    ) -> None:
        """Let an item go just over the rim, and wait."""
        x, y, rim_m = self.layout.compartment(compartment)
        self.place(item, np.array([x + aside_m, y, rim_m + 0.06]), np.array(axis, float))
        self.wait(3.0)

    def wait(self, seconds: float) -> None:
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.model.opt.timestep))

    def weights_n(self) -> dict[str, float]:
        names = self.site.bins[0].compartments
        return {name: scale_weight_n(self.model, self.data, self.site.bins[0].name, name) for name in names}

    def inside(self, item: str, compartment: str) -> bool:
        return self.layout.contains(compartment, tuple(self.data.body(item).xpos))


def test_things_wedged_between_the_walls_weigh_what_they_weigh() -> None:
    lab = Bin([(ItemClass.PLASTIC, "bottle", 0.2), (ItemClass.PLASTIC, "bottle", 0.2)])
    x, y, _ = lab.layout.compartment("yellow")
    # Both lean across the compartment, one on top of the other.
    lab.place("item0", np.array([x - 0.032, y, 0.17]), np.array([0.15, 1.0, 0.55]))
    lab.place("item1", np.array([x + 0.032, y, 0.20]), np.array([-0.15, 1.0, -0.6]))
    lab.wait(4.0)
    assert lab.inside("item0", "yellow") and lab.inside("item1", "yellow")
    assert lab.weights_n()["yellow"] == pytest.approx(0.4 * GRAVITY, abs=0.02)


def test_what_falls_into_one_compartment_moves_no_other_scale() -> None:
    lab = Bin(
        [(ItemClass.PLASTIC, "bottle", 0.03), (ItemClass.METAL, "can", 0.03), (ItemClass.PAPER, "ball", 0.2)]
    )
    lab.drop("item0", "yellow")
    lab.drop("item1", "yellow", aside_m=0.03)
    before = lab.weights_n()
    lab.drop("item2", "blue")
    after = lab.weights_n()
    assert after["blue"] == pytest.approx(0.2 * GRAVITY, abs=0.02)
    for name in ("yellow", "green", "grey"):
        assert after[name] == pytest.approx(before[name], abs=0.02)


def test_the_labs_own_items_are_weighed_one_after_another() -> None:
    site = Site.load(LAB)
    lab = Bin([(item.item_class, item.shape, item.mass_kg) for item in site.items])
    expected = dict.fromkeys(site.bins[0].compartments, 0.0)
    for item in lab.site.items:
        compartment = site.bins[0].compartment_of(item.item_class)
        expected[compartment] += item.mass_kg * GRAVITY
        lab.drop(item.id, compartment)
        assert lab.inside(item.id, compartment)
        assert lab.weights_n() == pytest.approx(expected, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "shape", [(ItemClass.PLASTIC, "bottle"), (ItemClass.METAL, "can"), (ItemClass.CARDBOARD, "tube")]
)
def test_four_things_fit_below_the_rim(shape: tuple[ItemClass, str], seed: int) -> None:
    lab = Bin([(*shape, 0.2)] * 4)
    rng = np.random.default_rng(seed)
    for item in lab.site.items:
        lab.drop(item.id, "yellow", aside_m=rng.uniform(-0.02, 0.02), axis=tuple(rng.normal(size=3)))
    assert [item.id for item in lab.site.items if not lab.inside(item.id, "yellow")] == []
    assert lab.weights_n()["yellow"] == pytest.approx(4 * 0.2 * GRAVITY, abs=0.03)
