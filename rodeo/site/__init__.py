"""One site: its file, its processes, its keys on the bus, its addresses, certificates and seed.

Only descriptions, no connections. What is in the lab is in `rodeo.lab`, the bus in `rodeo.bus`.
"""
