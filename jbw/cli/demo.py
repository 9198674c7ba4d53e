"""`jbw demo`: the virtual rig measured and identified, start to finish."""

from pathlib import Path

import click

from jbw.cli.running import identify_into, prepare_jax, progress


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("demo"),
    show_default=True,
    help="Folder for the records and the results, new or empty.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of everything random.")
@click.option(
    "--preset",
    type=click.Choice(["laboratory", "paper"]),
    default="laboratory",
    show_default=True,
    help="Drive of the rig; with `paper` already the weakest sweep saturates the joint.",
)
@click.option("--json", "json_", is_flag=True, help="Print the summary as JSON.")
def demo(out: Path, seed: int, preset: str, json_: bool) -> int:
    """Measure the paper's cantilever on the virtual rig and identify it.

    Writes the records with their campaign file to OUT/campaign, and the results beside them. The
    exit code is about the joint posterior of Step 4; the paper's own Step 3 is expected to fail,
    and the report says why.
    """
    prepare_jax()
    from jbw import rig
    from jbw.study.storage import claim

    claim(out)
    with progress() as say:
        say("Measuring the virtual rig")
        measured = rig.measure(preset, seed=seed)
        path = rig.write(measured, out / "campaign")
        truth = {**measured.truth["joint"], "gain": measured.truth["gain"]}
        del measured  # the identification reads the files, as for anyone
        return identify_into(path, out, seed=seed, json_=json_, truth=truth, say=say)
