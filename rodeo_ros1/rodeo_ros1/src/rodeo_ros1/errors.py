"""Errors: each says where something is wrong."""


class RelayError(Exception):
    """A file, a message or the other side is not as it should be."""


class ConfigError(RelayError):
    """The configuration cannot be used."""


class Malformed(RelayError):
    """A message is not of its type."""


class Refused(RelayError):
    """The other side did not answer, or answered with an error."""
