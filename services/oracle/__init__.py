"""Decides whether the work that a proof shows was done: provenance, replay in physics, energy audit."""
