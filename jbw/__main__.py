"""The entry point of `python -m jbw`: the command `jbw`, if scripts are not on the path."""

from jbw.cli import main

main()
