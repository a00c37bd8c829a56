"""Tools for honest runs and forgeries of a kind of work: a film workshop, a forger's workshop,
honest noise, and public fakes of other processes. Nothing that runs beside keys imports it."""

BINS = 'bins = [{ name = "itrash", pose = { x_m = 5.2, y_m = 4.45, yaw_rad = -1.5708 } }]'
"""The lab's bin as a line of a site file, with its page on a free port."""
