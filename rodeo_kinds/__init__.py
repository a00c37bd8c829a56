"""The kinds of work that come with RODEO. Each is a package like anybody's: nothing imports it by name."""
