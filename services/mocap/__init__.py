"""The lab's motion capture: reads a system of cameras, publishes the poses of bodies and signs them."""
