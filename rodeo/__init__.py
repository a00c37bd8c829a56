"""What every RODEO process agrees on: configuration, keys, messages, clock, bus, chain client, evidence.

No service's behaviour lives here; a service imports `rodeo`, never another service.
"""
