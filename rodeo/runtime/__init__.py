"""The process that every service is: its base class, life on the bus, simulated clock, logs, health.

What it needs of the machine is in `rodeo.host`; what a service does is in `services`.
"""
