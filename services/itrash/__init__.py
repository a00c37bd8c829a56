"""The smart bin: photo -> class -> compartment, and what really fell where, signed."""
