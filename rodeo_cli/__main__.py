"""`rodeo`, and `python -m rodeo_cli`."""

import signal


def main() -> None:
    """The command line."""
    # Importing takes a second, in which there is nothing to stop: Ctrl-C ends it without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from rodeo.text.redaction import hide_in_tracebacks

    hide_in_tracebacks()  # before typer is imported, which keeps the hook that it finds
    from rodeo_cli import app

    signal.signal(signal.SIGINT, signal.default_int_handler)
    app()


if __name__ == "__main__":
    main()
