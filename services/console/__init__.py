"""The organization in a browser: what happens, what it costs, and the buttons that change it."""
