"""The sequence of steps of Teloli et al. for a campaign, each with earlier results fixed."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from jaxtyping import Array, Key

from jbw.errors import DataError
from jbw.identification.assemble import Measured, Report
from jbw.identification.linear_step import LinearStep
from jbw.identification.paper import step3, step4
from jbw.identification.step import Step, means_of
from jbw.inference.samplers.chunked_run import Keep
from jbw.measurement.records import drive_of
from jbw.observables.forms import by_form
from jbw.observables.records import Records
from jbw.report.messages import paper_steps as messages
from jbw.report.messages import stages

PAPER_LAW = "bouc_wen"  # the law of Steps 3 and 4


@dataclass(frozen=True)
class PaperRoute:
    """The results of Steps 3 and 4 of Teloli et al., if a campaign's tests allow them."""

    kernel: step3.KernelFit | None = None  # fit of the kernel; None without probing tones
    steps: Mapping[str, Step] = field(default_factory=dict)  # posteriors, by name
    statements: tuple[str, ...] = ()  # sentences on laws that do not suit Steps 3 and 4

    @property
    def means(self) -> dict[str, float]:
        """The posterior means of Steps 3 and 4, at which the joint posterior starts."""
        names = [name for name in ("third_order_nuts", "opening_nuts") if name in self.steps]
        return {k: v for name in names for k, v in means_of(self.steps[name].posterior).items()}


def paper_route(
    seen: Measured, keys: Iterator[Key[Array, ""]], report: Report, keep: Keep
) -> PaperRoute:
    """Perform Steps 3 and 4 of Teloli et al. if the tests and the law of a campaign allow them.

    A step that the tests do not allow is omitted with a message, or raises an error if settings are
    strict.

    Raises:
        DataError: The tests do not allow the steps, and settings are strict.
    """
    statements = paper_words(seen)
    if statements:
        report(statements[0])
    if seen.linear is None or not seen.probing or PAPER_LAW not in seen.laws:
        return PaperRoute(statements=statements)
    try:
        return _steps(seen, seen.linear, keys, report, keep)
    except DataError as error:
        if seen.settings.strict:
            raise
        report(messages.left_out(" ".join(str(error).split())))
        return PaperRoute(statements=statements)


def paper_words(seen: Measured) -> tuple[str, ...]:
    """Explain why Steps 3 and 4 of Teloli et al. do not suit the laws; return () if they do."""
    if seen.linear is None or not seen.probing:
        return ()
    others = " and ".join(name for name in seen.laws if name != PAPER_LAW)
    if PAPER_LAW not in seen.laws:
        return (messages.other_law(others or "none"),)
    if not others:
        return ()
    return (messages.further_laws(others),)


def _steps(
    seen: Measured, linear: LinearStep, keys: Iterator[Key[Array, ""]], report: Report, keep: Keep
) -> PaperRoute:
    settings, statements = seen.settings, paper_words(seen)
    how = {"keep": keep, "statements": statements}
    report(stages.kernel(len(seen.probing)))
    kernel_fit = step3.fit_kernel(next(keys), seen.probing, linear.pooled, settings)
    steps = step3.third_order_steps(next(keys), kernel_fit, settings, **how)
    drive = drive_of(linear.test)
    if swept := by_form([test for test in seen.swept if drive_of(test) == drive]):
        # Use only the group of equally sampled sweeps with the most levels, because the curve over
        # gamma then needs one simulation.
        report(stages.STEP_4)
        records = Records.of(max(swept, key=len), substeps=settings.substeps)
        held = steps["third_order_nuts"]
        steps |= step4.opening_steps(next(keys), records, linear.pooled, held, settings, **how)
    return PaperRoute(kernel_fit, steps, statements)
