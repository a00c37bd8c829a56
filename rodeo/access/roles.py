"""What people may do."""

from enum import StrEnum


class Role(StrEnum):
    """What a person may do; named as in the contracts."""

    ADMINISTRATOR = "administrator"
    OPERATOR = "operator"
    TREASURER = "treasurer"
    AUDITOR = "auditor"
    EXECUTOR = "executor"
