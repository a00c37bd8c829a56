"""Benchmarks: each module of this package measures one area; its `run()` returns named figures."""
