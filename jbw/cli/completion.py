"""The command `jbw completion SHELL`."""

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes SHELL complete the commands and options of jbw.

    Put `eval "$(jbw completion bash)"` into ~/.bashrc, the same with zsh into ~/.zshrc, or write
    what it prints for fish to ~/.config/fish/completions/jbw.fish.
    """
    from jbw.cli import cli

    found = get_completion_class(shell)
    if found is None:  # Click knows all three
        raise click.UsageError(f"Click completes nothing in {shell}.")
    click.echo(found(cli, {}, "jbw", "_JBW_COMPLETE").source())
