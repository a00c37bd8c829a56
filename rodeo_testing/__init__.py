"""What honest runs and forgeries of a kind of work are made with: a film workshop, a forger's workshop,
honest noise, and public fakes of other processes. Nothing that runs beside keys imports it."""
