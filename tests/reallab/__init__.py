"""A lab without the simulator: a world that speaks the protocols of real devices and knows nothing of this
project, and a bin of another make. `tests.support.reallab` starts these programs."""
