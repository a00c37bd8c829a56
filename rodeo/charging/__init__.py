"""What buyer and seller of a charge agree on: the order, the tariff, the meter and its records.

The kind of work itself is `rodeo_kinds.battery_charging`, the dock's process `services.charger`.
"""
