"""Evidence of work: one sealed MCAP file per task, signed statements by devices, content-addressed stores.

`Recorder` writes a recording, `open_proof` reads one from a stranger, `open_bag` one that nobody sealed,
`Store` keeps and fetches them, `attest` and `verify_attestation` sign and check statements of other devices.
Nothing here judges (`rodeo.checks`), and nothing uses the bus (`rodeo.recording`).
"""
