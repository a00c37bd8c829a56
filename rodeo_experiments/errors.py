"""What can go wrong with an experiment.

RodeoError
└── ExperimentFailed    it did not reach its end, or its site cannot be used for it
"""

from rodeo.errors import RodeoError


class ExperimentFailed(RodeoError):
    """The experiment did not reach its end, or its site cannot be used for it."""
