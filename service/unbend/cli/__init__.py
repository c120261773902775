"""The command line. Commands import large dependencies when they run, so that --help is fast."""

from unbend.cli.main import main

__all__ = ["main"]
