"""The first stages, which every kind of work begins with, and those of people's work."""

from rodeo.checks import declared, people, provenance
from rodeo.checks.case import Checks, Stage
from rodeo.checks.counts import within_counts

COUNTED: Stage = (within_counts,)

PROVENANCE: Stage = (
    provenance.task_binding,
    provenance.nonce,
    provenance.signer,
    provenance.recorded_in_assignment,
    provenance.sealed_while_recording,
)

PEOPLE = Checks(
    stages=(
        COUNTED,
        tuple(people.executors_own_seal if check is provenance.signer else check for check in PROVENANCE),
        (declared.not_given_up,),
        (people.stated,),
        (people.judged_by_people,),
    ),
    recognizes=lambda proof, _site: any(event.get("event") == "statement" for event in proof.events()),
)
"""For kinds of work that people judge: `rodeo verify` says what stands in the proof, and accepts none."""
