"""Findings that answer the question whether the computation has converged."""

from jbw.report.messages.message import Message
from jbw.report.messages.remedies import draw_more

RANGE = "it must be at least {limit:g}."
SIZE = "{size:.4g}; " + RANGE

MESSAGES = (
    Message(
        "not_sampled",
        "The posterior was not sampled: {intervals}.",
        """
        Check: whether the posterior was sampled. `jbw identify --quick` samples no posterior.
        Its draws come from a Gaussian approximation at the optimum, which has the covariance of
        the fit, in the coordinates of the sampler and within the prior. The offsets of sessions
        are drawn from one Gaussian for each standard deviation that they may have.

        Where the data identify every parameter, these intervals are close to those of the
        posterior. Where parameters trade off or lie near a threshold, the posterior is curved. To
        detect this, the likelihood is computed two standard deviations from the optimum along each
        principal axis. If the posterior is curved, a few thousand points that are weighted by the
        likelihood replace the Gaussian.

        Remedy: `jbw resume DIR`, or the same command without --quick, samples the posterior.
        """,
        remedy="Sample the posterior by jbw resume DIR, where DIR is this run's folder, or by "
        "jbw identify without --quick.",
    ),
    Message(
        "non_finite",
        "{count} draws of the parameter {name} are not finite.",
        """
        Check: whether every draw of every parameter is a finite number.

        A NaN or an infinity means that the sampler left the region where the model can be
        solved. Every mean of such draws is meaningless. Their R-hat is NaN too, and a comparison
        of NaN with a limit fails silently: this check therefore comes first.

        Remedy: narrow the prior to where the model can be solved (`[identify.prior]`), or raise
        `substeps`.
        """,
        remedy="Run jbw check to find NaN in the records.",
        passed="All draws of all parameters are finite.",
    ),
    Message(
        "frozen_chain",
        "{count} of {num_chains} chains never moved in {name}.",
        """
        Check: whether every chain moves.

        A chain that accepts no proposal has no spread. R-hat of several such chains may look
        good.

        Remedy: start from the fit (jbw does so by itself), or use another `sampler`.
        """,
        remedy='Sample from the whole prior. Put under [identify]: `sampler = "tempered_smc"`.',
        passed="Every chain moves in every parameter.",
    ),
    Message(
        "r_hat",
        "R-hat of {name} is {r_hat:.4g}; it must be below {limit:g}.",
        """
        Check: rank-normalised split R-hat of every parameter and every derived quantity; it must
        be below 1.01 (Vehtari et al. 2021, Bayesian Analysis 16, 667). With one chain it is not
        assessed.

        R-hat compares the spread between chains with the spread within them. Above the limit,
        the chains still depend on their starts, and their mean is not the posterior mean.

        Remedy: leave `sampler` and `num_samples` out of `[identify]`; jbw then draws until the
        chains converge. Where chains mix slowly along alpha*delta, `coordinates = "products"` or
        `sampler = "nuts"` helps more.
        """,
        remedy=draw_more,
    ),
    Message(
        "r_hat.one_chain",
        "R-hat cannot be computed: it compares chains, and there is only one chain.",
        remedy="Sample several chains. Put under [identify]: `num_chains = {num_chains}`.",
    ),
    Message(
        "ess_bulk",
        f"The bulk effective sample size of {{name}} is {SIZE}",
        """
        Check: effective number of independent draws in the bulk of every quantity; at least 400.

        Correlated draws contain less information than independent ones. The paper's chain of 850
        draws has an effective sample size of 11 to 20.

        Remedy: raise `num_samples`; or see r_hat.
        """,
        remedy=draw_more,
    ),
    Message(
        "ess_tail",
        f"The tail effective sample size of {{name}} is {SIZE}",
        """
        Check: effective number of independent draws for the quantiles at the ends of intervals;
        at least 400.

        A 99 % interval needs more draws than a mean: one draw in two hundred lies beyond either
        end.

        Remedy: raise `num_samples`.
        """,
        remedy=draw_more,
    ),
    Message(
        "response_bands",
        explanation="""
        Check: R-hat and effective sample sizes of the quantities that determine response bands:
        natural frequency and damping ratio of the joint at several amplitudes up to the largest
        fitted amplitude. The limits are those of r_hat, ess_bulk and ess_tail.

        Parameters may mix while a combination of them does not. A 99 % band of an FRF, a sweep
        or a loop is as uncertain as the frequency and the damping at its amplitude.

        Remedy: raise `num_samples` in `[identify]`; or see r_hat.
        """,
    ),
    Message(
        "crossing",
        "The posterior of {name} has modes at {below:.4g} and {above:.4g}. The chains cross "
        "between them too seldom to determine their weights: the share of the draws in the first "
        "mode, {weight:.0f %}, depends on where the chains started.",
        """
        Check: whether the chains cross the deep valley between two modes of a posterior often
        enough to determine the weights of the modes. If the chains cross the valley too seldom,
        the share of draws in a mode depends on where the chains started.

        Remedy: `sampler = "tempered_smc"` or `"nested"` in `[identify]` determines the weights of
        modes.
        """,
        remedy="Use a sampler that determines the weights of modes. "
        'Put under [identify]: `sampler = "tempered_smc"`.',
        passed="No quantity has a posterior with two separate modes.",
    ),
    Message(
        "crossing.weighed",
        "The chains cross between the two modes of {name} often enough to determine their weights.",
    ),
    Message(
        "ess_weights",
        f"The effective sample size of the importance weights is {SIZE}",
        """
        Check: effective number of importance weights, the inverse of the sum of their squares.

        Draws of an approximation are weighted to become draws of the posterior. Where a few
        weights dominate, few draws remain.

        Remedy: raise `num_samples`, or use a sampler that makes chains.
        """,
        remedy="Use another sampler: a few points carry most of the weight. "
        'Put under [identify]: `sampler = "{sampler}"`.',
    ),
    Message(
        "khat",
        "Pareto k-hat of the importance weights is {khat:.2f}; it must be below {limit:g}.",
        """
        Check: the Pareto shape k-hat of the importance weights; it must be below 0.7 (Vehtari et
        al. 2024, JMLR 25, 72).

        Above the limit the largest weights dominate at any number of draws, and means do not
        converge: the approximation is too far from the posterior.

        Remedy: `sampler = "nuts"` or `"elliptical_slice"`.
        """,
        remedy="Use another sampler: the posterior is too far from its Gaussian approximation. "
        'Put under [identify]: `sampler = "{sampler}"`.',
    ),
    Message(
        "temperature",
        "The tempering ended at the inverse temperature {beta:.3g}; it must reach 1.",
        """
        Check: whether tempered sequential Monte Carlo reached the posterior, inverse temperature
        1.

        At a lower inverse temperature, its draws are of a flatter density than the posterior.

        Remedy: raise `num_samples`, or narrow the prior.
        """,
        remedy="Use another sampler: the time budget ended during the tempering. "
        'Put under [identify]: `sampler = "{sampler}"`.',
    ),
    Message(
        "quadrature",
        "The last refinement of the quadrature changed its result by {error:.2g} standard "
        "deviations or nats; the change must be at most {limit:g}.",
        """
        Check: the error of the quadrature of the posterior, from halving its nodes.

        Remedy: use another sampler where the grid does not resolve a well-identified parameter.
        """,
        remedy="Use another sampler: the grid of the quadrature is too coarse for this posterior. "
        'Put under [identify]: `sampler = "{sampler}"`.',
    ),
    Message(
        "divergences",
        "{count} of {size} trajectories of NUTS diverged or met a point where the model could not "
        "be solved; there must be none.",
        """
        Check: trajectories of NUTS that diverged or met a point where the model could not be
        solved; there must be none.

        A divergence marks a region where the curvature of the posterior is too large for the
        step. Draws avoid the region, and intervals become too narrow (Betancourt 2017,
        arXiv:1701.02434).

        Remedy: another sampler, as the finding says; or find the region of the prior where the
        divergences lie and narrow the prior, or `coordinates = "products"`.
        """,
        remedy="Use a sampler without trajectories. "
        'Put under [identify]: `sampler = "tempered_smc"`. '
        "If the model cannot be solved, use smaller time steps. "
        "Put under [identify]: `substeps = {substeps}`.",
        passed="All {size} trajectories of NUTS ended without a divergence, and the model could be "
        "solved everywhere.",
    ),
    Message(
        "failed_solves",
        "The model could not be solved at {share:.2g %} of the proposals; the limit is {limit:g "
        "%}.",
        """
        Check: proposals at which the model could not be solved; at most 1 %.

        The sampler treats such a point as impossible. Many of them truncate the posterior where
        only the solver failed.

        Remedy: narrow the prior, or raise `substeps`.
        """,
        remedy="Narrow the prior, or use smaller time steps. "
        "Put under [identify]: `substeps = {substeps}`.",
    ),
    Message(
        "tree_depth",
        "{share:.2g %} of the trajectories of NUTS reached the maximum tree depth; the limit is "
        "{limit:g %}.",
        """
        Check: trajectories of NUTS that reached the maximum tree depth; at most 5 %.

        Remedy: raise `num_warmup`. If you sample with your own program, start from the fit and
        its covariance, as jbw does.
        """,
        remedy="Lengthen the warm-up. Put under [identify]: `num_warmup = {num_warmup}`.",
    ),
    Message(
        "e_bfmi",
        f"The lowest E-BFMI of a chain is {{e_bfmi:.2f}}; {RANGE}",
        """
        Check: energy Bayesian fraction of missing information (E-BFMI) of every chain; at least
        0.3 (Betancourt 2016, arXiv:1604.00695).

        Below the limit, the momenta explore the energies of the posterior too slowly, and the
        draws miss its tails.

        Remedy: use other coordinates, or an informative prior where the data give no information.
        """,
        remedy="Use another sampler: the draws miss the tails of the posterior. "
        'Put under [identify]: `sampler = "tempered_smc"`.',
    ),
    Message(
        "budget",
        "The time budget of {spent:.3g} s ended before the draws converged.",
        """
        Check: whether the draws converged within the time budget.

        The number of draws doubles until every parameter, product and response band has an
        effective sample size of 400 and R-hat below 1.01, unless `num_samples` fixes it.

        Remedy: set `budget_s` in `[identify]` to the estimate of the finding. First look at the
        other findings: chains that never agree converge in no budget.
        """,
        remedy="Raise the time budget; at the present rate the new budget is enough. "
        "Put under [identify]: `budget_s = {budget}`.",
    ),
    Message(
        "second_posterior",
        "{reason} The posterior of all tests together does not depend on that of the free decays.",
        """
        Check: whether the posterior of the free decays alone, with which the posterior of
        all tests together is compared, could be sampled.

        The posterior of all tests together does not depend on the posterior of the free decays
        alone: only the comparison is missing.

        Remedy: identify the free decays in a separate campaign; its messages show the cause.
        """,
        remedy="Identify the free decays in a separate campaign; its messages show the cause.",
    ),
    Message(
        "incomplete_checks",
        lambda sentences: " ".join(sentences),
        """
        Check: whether every check of the posterior could be made.

        The question of a check that could not be made stays open, and the verdict is at best
        *not assessed*.
        The draws themselves are complete.

        Remedy: look at the tests that the finding names (`jbw look`), or keep them out of the fit
        by `hold_out`.
        """,
        remedy="Look at the tests that the finding names (jbw look), or keep them out of the fit "
        "by `hold_out`. The draws of the posterior are complete.",
    ),
    Message(
        "solver_error",
        "Halving the solver's time step moves the posterior means by at most {shift:.2g} standard "
        "deviations; this must be below {limit:g}.",
        """
        Check: the change of the log likelihood over the posterior when the solver's step is
        halved. The change must move every posterior mean by less than 0.1 standard deviations.

        Remedy: set `substeps` in `[identify]` to twice its value.
        """,
        remedy="Use smaller time steps. Put under [identify]: `substeps = {substeps}`.",
    ),
    Message(
        "series",
        "The Chebyshev series of the log likelihood has an error of {error:.2g} nats over the "
        "posterior; it must be below {limit:g}.",
        """
        Check: the error, in nats, of the Chebyshev series that approximates the log likelihood
        of gamma.

        Remedy: narrow the prior of gamma.
        """,
        remedy="Narrow the prior to the range of the draws. {line}",
    ),
)
