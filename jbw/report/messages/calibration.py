"""Findings of a calibration by simulation: do intervals contain the true value?"""

from jbw.report.messages.message import Message

MESSAGES = (
    Message(
        "calibration_ranks",
        "The ranks of the true values are least uniform for {name}: the smallest of {count} "
        "p-values ({test}), multiplied by {count}, is p = {p:.2g}; it must be at least "
        "{limit:g}.",
        """
        Check: the ranks of the simulated true values among the draws of their posteriors, by the
        exact simultaneous envelope of their ECDF and by chi-square; the smallest p-value times the
        number of p-values must be at least 0.01.

        A slope in the figure shows a bias; ranks that pile up at both ends show intervals that
        are too narrow, ranks that pile up in the middle intervals that are too wide. The log
        likelihood is among the quantities: only its ranks detect a likelihood that omits data.

        Remedy: try another sampler with `--sampler`; if that fails too, the likelihood is not
        that of the data. Step 3 with the noise estimated from few repeats is overconfident:
        measure more repeats, or see the result of `--noise known`.
        """,
        remedy="Look at the shape of the ranks in the figure: a slope shows a bias, a hump "
        "intervals that are too wide, a trough intervals that are too narrow.",
    ),
    Message(
        "calibration_coverage",
        "The 99 % interval of {name} contains the true value in {share:.4g %} of {count} "
        "replications; the confidence interval of this share, {low:.4g %} to {high:.4g %}, "
        "excludes 99 %.",
        """
        Check: the share of simulated true values inside the central 99 % interval of their
        posterior, over all quantities. The Clopper-Pearson interval of this share must contain
        99 %.

        Remedy: do not quote the intervals as 99 % intervals; see calibration_ranks.
        """,
        remedy="Do not quote these intervals as 99 %.",
        passed="The 99 % intervals of every quantity contain the true value in at least "
        "{share:.4g %} of {count} replications.",
    ),
    Message(
        "calibration_failures",
        "{share:.2g %} of the replications failed ({counted:list}); the limit is {limit:g %}.",
        """
        Check: the share of replications that failed, because draws are not finite, the sampler did
        not finish, or chains disagree (R-hat above 1.1); at most 1 %.

        Failed replications stay in the ranks and in the coverage; without them, both would be
        biased.

        Remedy: use another sampler, draw more samples, or narrow the prior.
        """,
        remedy="Use another sampler, or draw more samples.",
    ),
)
