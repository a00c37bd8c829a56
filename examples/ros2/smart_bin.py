"""Where a smart bin's points are on the map, m: as the site file's `bins` say, or as they were measured."""

import math

PARKED, AWAY = 0.5825, 1.4
"""From its centre to the robot's: while the arm works over it, and to make room."""
RIM, VIEW = 0.42, 0.72
"""Heights of its rim, and of the middle of what its camera looks at."""
PITCH = 0.222
"""From one compartment to the next."""


class SmartBin:
    """A row of compartments. `heading` is where its front looks, and the first compartment is on its left."""

    def __init__(self, name, x, y, heading, compartments):
        self.name, self._compartments = name, compartments
        self._place, self._front, self._heading = (
            complex(x, y),
            complex(math.cos(heading), math.sin(heading)),
            heading,
        )

    @property
    def parking(self):
        """x, y and heading of a robot that works over it."""
        place = self._place + PARKED * self._front
        return place.real, place.imag, self._heading + math.pi

    @property
    def way_out(self):
        place = self._place + AWAY * self._front
        return place.real, place.imag, self._heading

    @property
    def view(self):
        return self._place.real, self._place.imag, VIEW

    def opening(self, compartment):
        """The middle of a compartment, at the height of the rim."""
        left = PITCH * ((len(self._compartments) - 1) / 2 - self._compartments.index(compartment))
        place = self._place + left * 1j * self._front
        return place.real, place.imag, RIM
