"""Findings on the question: do the data identify the parameters?"""

from jbw.report.messages.message import Message, capital

TRUNCATED = (
    "The {side} prior bound truncates {name}: {share:.2g %} of its draws lie within {edge:g %} "
    "of the posterior's 99 % span from the bound."
)

MESSAGES = (
    Message(
        "no_joint",
        "No joint is detected: at {y:.2g} m, the largest motion fitted, it changes the natural "
        "frequency by less than {frequency:.2g %} and adds less than {damping:.2g %} of zeta "
        "to the damping; without it chi-square grows by only {growth:.2g}.",
        """
        Check: the growth of chi-square when the oscillator is fitted without the joint to the
        same data with the same weights; more than so many parameters reach by chance at a
        probability of 1 %. It is made only where the posterior hardly tells the joint's change
        of the frequency from zero.

        Below the limit, the structure is as well described without the joint. The finding states
        the largest effect that the joint may have.

        Remedy: drive harder, for a joint in full stick is a spring; or state `laws = []` in
        `[joint]`.
        """,
        remedy="Drive harder; so far the structure is linear. Put under [joint]: `laws = []`.",
        passed="Without the joint chi-square grows by {growth:.3g}, by chance {least:.3g}.",
    ),
    Message(
        "at_bound",
        TRUNCATED,
        """
        Check: draws nearer to a prior bound than 1 % of the span of the posterior from its 0.5 %
        to its 99.5 % quantile; a uniform posterior has 1 % of its draws there, more than 1.5 %
        fail. A lower bound of zero is not checked: the quantity ends there by itself, and an
        upper limit is a valid result.

        The bound truncates the posterior: its interval is that of the prior, not of the data.

        Remedy: widen the bound in `[identify.prior]` if physics allows it, else doubt the model.

        A stiffness of the joint that may be as large as the whole stiffness ends there by itself as
        well: its lower limit is a valid result, and the data identify the products alpha*delta and
        alpha*gamma.
        """,
        remedy="{line} If no wider bound makes sense, doubt the model.",
        passed="No prior bound truncates a parameter.",
    ),
    Message(
        "at_bound.ends",
        "The data tell a lower limit of {name}: it may be as large as the stiffness itself.",
        remedy="Report the products of {name}, which are identified, or measure at higher levels, "
        "which tell {name} by itself.",
    ),
    Message(
        "unidentified_joints",
        lambda joints: (
            f"{'Joint' if len(joints) == 1 else 'Joints'} {', '.join(joints)} "
            f"{'is' if len(joints) == 1 else 'are'} not identified: the effect of "
            f"{'this joint' if len(joints) == 1 else 'each'} is uncertain by a factor of two or "
            "more, which does not mean that it is small. The effect of all joints together on each "
            "mode is identified."
        ),
        """
        Check: of each of several joints, the change of frequency and the damping that it alone
        makes, in the mode that shows it best; each must be known within a factor of two.

        Weak motion of one mode tells the sum of what its joints do. Joints are told apart by
        modes that they move by different amounts: see the matrix B of `jbw check`.

        Remedy: sweep a further mode that moves the joint, or let it share the law of another by
        `same_as`.
        """,
        remedy="Sweep a further mode that moves it, or tie it to another joint by `same_as`.",
        passed="Every joint is identified by itself.",
    ),
    Message(
        "unidentified",
        lambda names, text, ratio: (
            f"{capital(text)}: along one direction of {', '.join(names)} the posterior has "
            f"{ratio:.2f} of the prior's standard deviation."
        ),
        """
        Check: directions along which the posterior's standard deviation is more than 0.7 times
        the prior's, in logarithms of parameters that cannot be zero, and in the parameters
        themselves.

        The data do not separate these parameters, or hold no information on them. Small motion
        identifies only alpha*delta and alpha*gamma: the first terms of the loop hold nothing
        else.

        Remedy: report the combination; or add a test at higher amplitude, which `jbw plan DIR`
        chooses. `jbw identifiability CAMPAIGN.toml` shows all this before any sampling.
        """,
        # No remedy states the posterior's interval: as a prior it would count the data twice.
        remedy="Report the combination, or add tests at higher amplitude (jbw plan). If you know "
        "{name} from another source, put its range in the place of the present bounds, "
        "{low:.3g} to {high:.3g}, under [identify.prior].",
        passed="The data identify every combination of the parameters.",
    ),
    Message(
        "modes",
        "The posterior of {name} has modes at {below:.4g} and {above:.4g} with weights "
        "{weight:.3f} and {rest:.3f} +- {error:.1g}.",
        """
        Check: whether a deep valley separates the draws of a quantity into two modes, each with
        2 % of the draws or more. Modes that overlap in every single quantity are not detected.

        The data allow two answers with the stated weights and their Monte Carlo error. A mean, a
        standard deviation or an interval of both describes neither.

        Remedy: report each mode with its weight. A test at another level often decides between
        them (`jbw plan DIR`).
        """,
        remedy="Report each mode with its weight: a mean between them describes neither.",
    ),
)
