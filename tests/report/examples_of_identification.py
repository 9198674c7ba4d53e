"""What an identification says, with example values, topic by topic, constants aside."""

from jbw.report.messages import causes, effects, residuals

EXAMPLES = {
    "causes": [
        causes.causes([(0.8, "a clock"), (0.2, "an offset")]),
        *causes.swapped("sweep"),
        *causes.delay(1e-3, "Put under [[test]]: `x = 1`."),
        *causes.clock(-81.2, "Put under [[test]]: `x = 1`."),
        *causes.turned("sweep", "Put under [[test]]: `x = 1`."),
        *causes.factor("sweep", 9.81, "units of g", "Put under [[test]]: `x = 1`.", is_turned=True),
        *causes.factor("sweep", 1.3, None, "Put under [[test]]: `x = 1`.", is_turned=False),
        *causes.offset(0.1, "Put under [[test]]: `x = 1`."),
        *causes.clipping(["sweep"]),
        *causes.residual_term(1e-6, "Put under [[test]]: `x = 1`."),
        *causes.natural_frequencies(0.002, "Put under [[test]]: `x = 1`."),
        *causes.further_mode(30.1, " Put under [[test]]: `band = [15.0, 23.0]`."),
    ],
    "effects": [
        effects.of_joint(1e-3, [-0.02, -0.01, -0.005], [0.1, 0.2, 0.3]),
        effects.of_joint(1e-3, [-0.02, -0.01, 0.005], [1.1, 1.2, 1.3]),
        effects.known_together(1e-3, 0.1, 0.05),
        effects.frequency_at(1e-3),
        effects.damping_at(1e-3),
        effects.readings(
            40,
            (0.1, 2.0),
            effects.turning(1e-3, 18.1, 18.4),
            effects.damping_grows((0.4, 0.5, 0.6), (0.4, 0.5, 0.6)),
        ),
        effects.readings(
            40,
            (0.1, 2.0),
            effects.frequency_falls((0.4, 0.5, 0.6), (0.4, 0.5, 0.6)),
            effects.damping_grows((0.4, 0.5, 0.6), (0.4, 0.5, 0.6)),
        ),
        effects.no_softening(grows=True),
        effects.no_softening(grows=False),
        effects.masing(
            (0.4, 0.5, 0.6), 0.5, effects.elastic_softening((0.4, 0.5, 0.6)), (0.4, 0.5, 0.6)
        ),
        effects.masing((0.4, 0.5, 0.6), 0.5, effects.SLIDERS, (0.4, 0.5, 0.6)),
        effects.smooth_alternative((0.4, 0.5, 0.6), (0.4, 0.5, 0.6)),
        effects.threshold((1e-4, 2e-4, 3e-4), 1e-3, "all that is behind the gap"),
        effects.threshold((5e-4, 1e-3, 2e-3), 1e-3, "all that is behind the gap"),
        effects.threshold((2e-3, 3e-3, 4e-3), 1e-3, "all that is behind the gap"),
    ],
    "residuals": [
        residuals.each_session("", ["day 1 2.3 %"]),
        residuals.outside_band("compliance (1e-6 m/N)", 0.4),
        residuals.neighbour(18.8, 0.01, 0.3, 0.5),
        residuals.usable_within(0.03, "sweep"),
        residuals.unseen_errors("held-out tests", 0.04, 0.02, residuals.worse_than_fitted(1.5)),
        residuals.unseen_errors("held-out tests", 0.04, 0.02, residuals.WITHIN_BANDS),
        residuals.across_kinds(
            {"sweep": (0.02, 0.01), "decay": (0.03, 0.02)}, {"decay": ["gamma"]}, own_frequency=True
        ),
        residuals.across_kinds({"sweep": (0.02, 0.01)}, {}, own_frequency=False),
    ],
}
