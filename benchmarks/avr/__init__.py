"""Cycles of the board's tick on an ATmega2560, measured in simavr."""
