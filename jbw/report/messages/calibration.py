"""Findings of a calibration by simulation: do intervals hold the truth?"""

from jbw.report.messages.message import Message

MESSAGES = (
    Message(
        "calibration_ranks",
        "The ranks of {name} are the least uniform: p = {p:.2g} by the {test}, the least of "
        "{count} p-values times their number; it must be at least {limit:g}.",
        """
        Check: the ranks of simulated truths among the draws of their posteriors, by the exact
        simultaneous envelope of their ECDF and by chi-square; the least p-value times the number
        of p-values must be at least 0.01.

        A slope in the figure is a bias; ranks that pile up at both ends mean too narrow an
        interval, in the middle too wide a one. The log likelihood is among the quantities: only
        its ranks detect a likelihood that omits data.

        Remedy: try another sampler with `--sampler`; if that fails too, the likelihood is not
        that of the data. Step 3 with the noise estimated from the scatter of few repeats is
        overconfident: measure more repeats, or see the result of `--noise known`.
        """,
        remedy="Look at the figure: a slope is a bias, a hump too wide an interval, a trough too "
        "narrow an interval.",
    ),
    Message(
        "calibration_coverage",
        "The 99 % interval of {name} holds the truth in {share:.4g %} of {count} replications; the "
        "confidence interval of that share, {low:.4g %} to {high:.4g %}, excludes 99 %.",
        """
        Check: the share of simulated truths inside the central 99 % interval of their posterior;
        99 % must be inside the Clopper-Pearson interval of that share, all quantities together.

        Remedy: do not quote such intervals as 99 %; see calibration_ranks.
        """,
        remedy="Do not quote these intervals as 99 %.",
        passed="The 99 % intervals of every quantity hold the truth in at least {share:.4g %} of "
        "{count} replications.",
    ),
    Message(
        "calibration_failures",
        "{share:.2g %} of the replications failed ({counted:list}); the limit is {limit:g %}.",
        """
        Check: the share of replications that failed: draws that are not finite, a sampler that
        did not finish, chains that disagree (R-hat above 1.1); at most 1 %.

        Failed replications stay in the ranks and in the coverage; without them, both would be
        biased.

        Remedy: use a sampler that copes with this posterior, or narrow the prior.
        """,
        remedy="Use a sampler that copes with this posterior, or more draws.",
    ),
)
