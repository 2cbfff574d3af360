"""`python -m vitruvian` is the command line."""

from vitruvian.cli import main

main()
