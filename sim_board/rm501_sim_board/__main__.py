"""`python -m rm501_sim_board`: the command line."""

from rm501_sim_board.cli import main

main()
