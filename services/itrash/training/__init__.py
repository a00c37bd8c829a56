"""How the bin's classifier is trained and measured: nothing of it runs on a site."""
