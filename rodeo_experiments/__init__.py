"""Whole days of a site, run and measured by one command: `rodeo experiment`."""
