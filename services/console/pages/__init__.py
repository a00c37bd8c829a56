"""The pages. Each module's `register(console)` adds its own."""
