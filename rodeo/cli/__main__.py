"""`python -m rodeo.cli` is `rodeo`."""

from rodeo.cli import app

if __name__ == "__main__":
    app()
