"""Dishonest proofs, from crude to careful, made from honest recordings: `CATALOGUE` names each with the check
that has to refuse it. Most are sealed with the executor's own key, which a dishonest executor has.
"""

from tests.forgeries import charges as charges
from tests.forgeries.catalogue import CATALOGUE, Forgery, listed
from tests.forgeries.workshop import Submission, Workshop

__all__ = ["CATALOGUE", "Forgery", "Submission", "Workshop", "listed"]
