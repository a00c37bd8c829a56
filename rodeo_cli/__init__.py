"""`rodeo`: run a site and use its organization from a terminal."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rodeo_cli.commands import app as app


def __getattr__(name: str) -> Any:
    # Imported when it is asked for: `rodeo_cli.__main__` sees to Ctrl-C before, because this takes a second.
    if name == "app":
        from rodeo_cli.commands import app

        return app
    raise AttributeError(name)
