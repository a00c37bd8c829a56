"""What buyer and seller of a charge agree on: the order, the tariff, the meter and its records.

The kind of work itself is in `rodeo_kinds`, the dock's process is `services.charger`.
"""
