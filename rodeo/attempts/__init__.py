"""A robot's attempts, in the one process that has the key of its device: its mind, or its recorder.

device      the key, and what is signed and served with it: presentations, orders, copies of proofs
room        what is kept of each attempt, and its recording while it grows
journal     the phase of an attempt, on disk before it matters
events      events of the chain, which go into the recording of their task
orders      what operators order

What the work is, `rodeo.robot.behaviour` tells; the file of a recording is written by `rodeo.evidence`.
"""
