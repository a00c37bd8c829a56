"""Jobs: verifications and other long computations that one process has done by others, here or elsewhere.

job         what is asked as a small JSON value, what an engine is, and how it fails
runner      has jobs done by an engine: each once, again where a worker was lost, and kept for the next time
local       the engine of this machine
apart       one verification in a child process with limits; the oracle's are done there, too
proofs      verifications as jobs

Nothing here knows which engine does a job, or has keys. What a verification finds is in `rodeo.checks`.
"""
