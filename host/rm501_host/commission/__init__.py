"""Setting up a real arm, finding lost steps, and judging the computer: `commission`, `verify`, `doctor`."""
