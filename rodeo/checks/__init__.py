"""The library of checks that all kinds of work share, and the verification that runs them.

A check is a function from a `Case` to a `Finding`; its name is the function's. Checks come in stages: a stage
is only entered when the one before it passed, so nothing expensive is computed from what is not trusted, and
what one check misses is not missed again by those that build on it. A kind's own checks are in `rodeo_kinds`.
"""
