"""What can go wrong with an experiment.

RodeoError
└── ExperimentFailed    it did not reach its end, or its site cannot be used for it
    └── NoFreePlace     nothing can be put down, or no robot rest, anywhere on the floor
"""

from rodeo.errors import RodeoError


class ExperimentFailed(RodeoError):
    """The experiment did not reach its end, or its site cannot be used for it."""


class NoFreePlace(ExperimentFailed):
    """Nothing can be put down, or no robot rest, anywhere on the floor."""
