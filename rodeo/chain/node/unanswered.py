"""Why a server gave no answer."""

from __future__ import annotations

import os
import socket
import ssl

import requests
import urllib3

NO_NODE = "the server there is not an Ethereum node"

_LONGEST_REASON = 120
"""Characters of another library's sentence."""


def why_unanswered(error: BaseException) -> str:
    """Why there was no answer, in a few words: what lies at the bottom of the HTTP libraries' exceptions."""
    causes = [error]
    for cause in causes:
        inner = (*cause.args, getattr(cause, "reason", None), cause.__cause__, cause.__context__)
        causes += [one for one in inner if isinstance(one, BaseException) and one not in causes]
    for cause in reversed(causes):
        if isinstance(cause, socket.gaierror):
            return "unknown host name"
        if isinstance(cause, ssl.SSLError):
            return "TLS failed: " + (cause.reason or "the TLS connection failed").lower().replace("_", " ")
        if isinstance(cause, TimeoutError | urllib3.exceptions.TimeoutError | requests.Timeout):
            return "no answer in time"
        if isinstance(cause, OSError) and cause.errno is not None:
            return os.strerror(cause.errno).lower()
        if isinstance(cause, ValueError) and not isinstance(cause, OSError | urllib3.exceptions.HTTPError):
            return NO_NODE
    first = str(causes[-1]).partition("\n")[0]
    return first[:_LONGEST_REASON] or type(error).__name__
