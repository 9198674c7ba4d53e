"""`python -m jbw`: the command `jbw`, where scripts are not on the path."""

from jbw.cli import main

main()
