"""`make demo`: the whole organization once, from a posted task to a paid charge."""
