"""What a process asks of the machine it runs on: clock, stamps, files, locks, HTTP, proxies, metrics.

Nothing here knows a site or the bus. The process itself is in `rodeo.runtime`.
"""
