"""Dishonest proofs, from crude to careful, made from honest recordings: `CATALOGUE` names each with the role
that makes it and the check that has to refuse it. Most are sealed with the executor's own key, which a
dishonest executor has. `composed` puts more together from primitives, by a seed.
"""

from tests.forgeries import catalogue as catalogue
from tests.forgeries import charges as charges
from tests.forgeries import others as others
from tests.forgeries.registry import CATALOGUE, ROLES, Forgery, kinds, listed
from tests.forgeries.workshop import Submission, Workshop

__all__ = ["CATALOGUE", "ROLES", "Forgery", "Submission", "Workshop", "kinds", "listed"]
