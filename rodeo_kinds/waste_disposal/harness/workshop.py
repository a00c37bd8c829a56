"""What a forger of cleanings works with."""

from __future__ import annotations

import math
from typing import Any

from rodeo.checks.case import ChainRecord
from rodeo.lab.config import BinConfig, FurnitureConfig, Pose2
from rodeo_kinds.waste_disposal.harness.film import KIND, cleaning_chain_record, film_cleaning
from rodeo_testing.harness import Harness
from rodeo_testing.recordings import Take
from rodeo_testing.workshop import Submission, Workshop

ITEM = "item3"
PLACE: dict[str, Any] = {"item_id": ITEM, "x_m": 5.4, "y_m": 2.5}
ITEM_POSE = f"mocap/{ITEM}/pose"
PICTURE = "itrash/camera/image/compressed"
SEEN = "panther1/item_pose"


class CleaningWorkshop(Workshop):
    """One item is carried into the bin."""

    kind = KIND

    def film(self) -> Take:
        film = film_cleaning(self.site, ITEM, via=())
        for other in self.site.items:
            if other.id != ITEM:
                film = film.without(f"mocap/{other.id}/pose")
        return film

    def chain_record(self, **task: Any) -> ChainRecord:
        return cleaning_chain_record(self.take, **({"params": PLACE} | task))

    def blind(self, take: Take) -> Submission:
        """`take` as proof of the cleaning task at a site without motion capture."""
        lab = self.site.lab.model_copy(update={"mocap": False})
        site = self.site.model_copy(update={"lab": lab})
        return Submission(self.chain_record(), self.sealed(take), site=site)

    def furnished(self, x_m: float, y_m: float, size_m: tuple[float, float, float]) -> Submission:
        """The honest proof, said to be of a lab in which a crate stands there."""
        crate = FurnitureConfig(name="crate", kind="crate", pose=Pose2(x_m=x_m, y_m=y_m), size_m=size_m)
        lab = self.site.lab.model_copy(update={"furniture": (*self.site.lab.furniture, crate)})
        site = self.site.model_copy(update={"lab": lab})
        return Submission(self.chain_record(), self.honest_file(), site=site)

    def beside_another_bin(self, **params: Any) -> Submission:
        """The honest proof, said to be of a site that has another bin, of a task with these parameters."""
        other = BinConfig(name="itrash2", pose=Pose2(x_m=1.0, y_m=0.4, yaw_rad=math.pi / 2))
        site = self.site.model_copy(update={"bins": [other, *self.site.bins]})
        return Submission(self.chain_record(params=PLACE | params), self.honest_file(), site=site)


HARNESS = Harness(CleaningWorkshop)


@HARNESS.honest
def an_item_carried_into_its_compartment(shop: CleaningWorkshop) -> Submission:
    """A robot takes the item, shows it to the bin, and drops it where the bin says."""
    return shop.submitted(shop.take)


@HARNESS.honest
def carried_into_one_of_two_bins(shop: CleaningWorkshop) -> Submission:
    """The task leaves the bin to the robot."""
    return shop.beside_another_bin()


@HARNESS.honest
def carried_into_the_bin_that_is_named(shop: CleaningWorkshop) -> Submission:
    """The task names the bin."""
    return shop.beside_another_bin(bin="itrash")
