"""`python -m rm501_host`: the command line."""

from rm501_host.cli import main

main()
