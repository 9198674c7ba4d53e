"""Findings that answer the question whether the data identify the parameters."""

from jbw.report.messages.message import Message, capital

TRUNCATED = (
    "The {side} prior bound truncates {name}: {share:.2g %} of its draws lie closer to the bound "
    "than {edge:g %} of the width of the 99 % interval (a uniform posterior has {edge:g %})."
)

MESSAGES = (
    Message(
        "no_joint",
        "No joint is detected: a fit without the joint raises chi-square by only {growth:.2g}. At "
        "{y:.2g} m, the largest fitted motion, the joint changes the natural frequency by less "
        "than {frequency:.2g %} and adds less than {damping:.2g %} of zeta to the damping.",
        """
        Check: the growth of chi-square when the oscillator is fitted without the joint to the
        same data with the same weights. The growth must exceed the limit that chance alone
        exceeds with a probability of 1 % if no joint exists. The check is made only if the joint's
        change of the frequency is within five standard deviations of zero.

        Below the limit, a structure without the joint describes the data equally well. The finding
        states the largest effect that the joint may have.

        Remedy: drive harder, because a fully stuck joint acts as a spring; or state `laws = []`
        in `[joint]`.
        """,
        remedy="Drive harder, or model the structure as linear. Put under [joint]: `laws = []`.",
        passed="A fit without the joint raises chi-square by {growth:.3g}; without a joint, chance "
        "alone raises it by at most {least:.3g} (99 %).",
    ),
    Message(
        "at_bound",
        TRUNCATED,
        """
        Check: the share of draws that lie closer to a prior bound than 1 % of the width of the
        99 % interval of the posterior. The share must not exceed 1.5 %; a uniform posterior has
        1 %. A lower bound of zero is not checked: the quantity cannot be negative, and an upper
        limit is a valid result.

        The bound truncates the posterior: one end of the interval is given by the prior, not by
        the data.

        Remedy: widen the bound in `[identify.prior]` if physics allows it; else check the model.

        The stiffness of a joint cannot exceed the whole stiffness. If it may be as large, its
        lower limit is a valid result, and the data identify the products alpha*delta and
        alpha*gamma.
        """,
        remedy="Widen the prior. {line} If no wider bound is physical, check the model.",
        passed="No prior bound truncates a parameter.",
    ),
    Message(
        "at_bound.ends",
        "The data determine only a lower limit of {name}, which may be as large as the whole "
        "stiffness.",
        remedy="Report the products that contain {name}: they are identified. To identify {name} "
        "itself, measure at higher levels.",
    ),
    Message(
        "unidentified_joints",
        lambda joints: (
            f"{'Joint' if len(joints) == 1 else 'Joints'} {', '.join(joints)} "
            f"{'is' if len(joints) == 1 else 'are'} not identified separately: the effect of "
            f"{'this joint' if len(joints) == 1 else 'each'} on frequency and damping is uncertain "
            "by a factor of two or more (a large effect is possible). The effect of all joints "
            "together on each mode is identified."
        ),
        """
        Check: for each of several joints, the change of frequency and the damping due to this
        joint alone, in the mode that shows it best; each must be known within a factor of two.

        At small motion one mode determines only the sum of the effects of its joints. Modes that
        move the joints by different amounts separate them: see the matrix B of `jbw check`.

        Remedy: sweep another mode that moves the joint, or let it share the law of another joint
        by `same_as`.
        """,
        remedy="Sweep another mode that moves the joint, or tie the joint to another joint by "
        "`same_as`.",
        passed="Every joint is identified separately.",
    ),
    Message(
        "unidentified",
        lambda names, text, ratio: (
            f"{capital(text)}: along one direction of {', '.join(names)} the standard deviation of "
            f"the posterior is {ratio:.2f} times that of the prior."
        ),
        """
        Check: find directions along which the standard deviation of the posterior exceeds 0.7
        times that of the prior. Parameters that cannot be zero are examined in logarithms, and
        all parameters also without logarithms.

        The data do not separate these parameters, or do not constrain them. Small motion
        identifies only alpha*delta and alpha*gamma: the first terms of the loop contain nothing
        else.

        Remedy: report the combination; or add a test at higher amplitude, which `jbw plan DIR`
        chooses. `jbw identifiability CAMPAIGN.toml` shows all this before any sampling.
        """,
        # No remedy states the posterior's interval: as a prior, it would count the data twice.
        remedy="Report the combination, or add tests at higher amplitude (jbw plan). If you know "
        "{name} from another source, state its range under [identify.prior] instead of the "
        "present bounds, {low:.3g} to {high:.3g}.",
        passed="The data identify every combination of the parameters.",
    ),
    Message(
        "modes",
        "The posterior of {name} has modes at {below:.4g} and {above:.4g} with weights "
        "{weight:.3f} and {rest:.3f} +- {error:.1g}.",
        """
        Check: whether a deep valley separates the draws of a quantity into two modes, each with
        2 % of the draws or more. Modes that overlap in every single quantity are not detected.

        The data allow two answers with the stated weights and their Monte Carlo error. One mean,
        standard deviation or interval over both describes neither.

        Remedy: report each mode with its weight. A test at another level often decides between
        them (`jbw plan DIR`).
        """,
        remedy="Report each mode with its weight: a mean over both modes describes no mode.",
    ),
)
