"""Trains and measures the bin's network. Nothing of it runs on a site, and the wheel does not hold it:
`rodeo/vision` loads the files that it makes."""
