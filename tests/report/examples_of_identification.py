"""What an identification says, with example values, topic by topic, constants aside."""

from jbw.report.messages import (
    causes,
    effects,
    instruments,
    modes,
    paper_steps,
    posterior,
    residuals,
    sessions,
)

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
    "instruments": [
        instruments.with_shaker("voltage"),
        instruments.mode_with_shaker("voltage", "18.1 Hz (1 %)", "18.8 Hz (1 %)"),
        instruments.attachment("voltage", 0.1, 0.03, at_drive_point=False),
        instruments.attachment("voltage", 0.2, 0.03, at_drive_point=True),
        instruments.heavy(0.02),
        instruments.shaker_reading(
            "voltage", 12.0, 0.1, 1.2, 1200.0, 0.02, 0.03, "18.8 Hz (1.00%) to 18.1 Hz (1.20%)"
        ),
        instruments.included([instruments.of_clock(1e-5)], []),
        instruments.included([], ["`gain_std` of force"]),
    ],
    "modes": [
        modes.growth_by_neighbours(12.0),
        modes.one_joint(modes.growth_by_neighbours(30.0), 9.2),
        modes.no_shared_joint(modes.growth_by_neighbours(3.0)),
        modes.compared("alpha", 0.3, 0.31, 18.8, 0.9, 1.1, modes.MAY_BE_COMMON),
        modes.still_mode(18.8, "gain_ratio_2", -0.1, 0.1),
        modes.one_serves(1.25),
        modes.left_by_joint(18.8, 0.2, 0.1),
        modes.rejected(modes.left_by_joint(18.8, 0.2, 0.1)),
        modes.hardly_seen(modes.numbered(2, 30.1)),
        modes.all_joints(modes.numbered(2, 30.1), [-2.0, -1.0, -0.5], [0.1, 0.2, 0.3]),
        modes.damped_by(2, "bolt_1", 0.8, 0.7, 0.9),
        modes.numbered(2, 30.1),
        modes.identified("bolt_1"),
        modes.outside_band(30.0, 15.0, 23.0),
    ],
    "paper_steps": [
        paper_steps.held_parameters("zeta, alpha, delta", "2.1 times", "0.3"),
        paper_steps.outside_interval(["gamma"]),
        paper_steps.wall_time(12.0, 30.0),
        paper_steps.product(12.0, 11.0, 13.0),
        paper_steps.left_out("There is no tone."),
        paper_steps.other_law("whose law is iwan4"),
        paper_steps.further_laws("cubic"),
    ],
    "posterior": [
        posterior.statement_on("tests"),
        posterior.sampler("amis", 12000, "logarithms"),
        posterior.evidence(-12.3, 0.02),
        posterior.in_group_unit("standard deviation of the noise"),
        posterior.at_bound("alpha", "upper"),
        posterior.by_initial_fit("only the product alpha*delta is determined"),
        posterior.products_sampled(
            ["alpha"], "delta", ["alpha_delta"], "product of alpha and delta"
        ),
        posterior.test_left_out("sweep", "It has no input."),
        posterior.widened(["gamma to [0, 4]"]),
        posterior.by_fit("only the product alpha*delta is determined"),
        posterior.check_of(posterior.REPEATS),
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
    "sessions": [
        sessions.differ(0.001, {"day 1": 0.1, "day 2": -0.1}, sessions.OF_EACH_RUN),
        sessions.of_each_level(0.021),
        sessions.population_mean([sessions.scatter((0.1, 0.2, 0.3), "runs")]),
    ],
}
