"""The outside world as people have reported it: named vices as rows of data, and what must happen with each.

`nodes.toml` are vices of Ethereum nodes and of the gateways in front of them, `files.toml` those of files
that others made, `environment.toml` those of machines and networks, `drivers.toml` those of robots' drivers
and of sensors. A row names its public report.
"""
