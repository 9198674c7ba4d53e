"""Faults of records and campaigns with example values, topic by topic, constants aside."""

from jbw.report.messages import (
    clock_faults,
    controlled_faults,
    decay_faults,
    loop_faults,
    record_faults,
    response_faults,
)

KEEP = "Put under [[test]]: `span = [0.0, 1.9]`"
EXCLUDE = 'leave the record out: `exclude = ["hit_3.mat"]`'
KEEP_OR_EXCLUDE = f"{KEEP}, or {EXCLUDE}"
EXAMPLES = {
    "clock_faults": [
        clock_faults.response_jumps(0.01, "behind"),
        clock_faults.phase_jumps(0.3),
        clock_faults.lost_block(2.0, clock_faults.phase_jumps(0.3), KEEP_OR_EXCLUDE),
        clock_faults.another_clock(81.2, "slow", 0.001, -81.2),
        clock_faults.another_delay("lags behind", 0.001, 0.0, 0.001),
    ],
    "controlled_faults": [
        controlled_faults.not_positive("force", 3),
        controlled_faults.few_points(4, 3),
        controlled_faults.put_scale("displacement"),
        controlled_faults.leading(88.0, controlled_faults.PUT_CONJUGATE),
        controlled_faults.put_locked_phase(-80),
        controlled_faults.put_tolerance(12.0),
        controlled_faults.off_phase(
            "points 3, 4", 12.0, -90.0, controlled_faults.put_tolerance(12.0)
        ),
        controlled_faults.frequency_jumps(18.8, 18.1),
        controlled_faults.amplitude_jumps(0.001, 0.003),
        controlled_faults.jumps(["3 and 4"], controlled_faults.amplitude_jumps(1e-3, 3e-3)),
    ],
    "decay_faults": [
        decay_faults.late_blow(0.5, 0.0, "0.6"),
        decay_faults.still_driven(1.5, "1.6"),
        decay_faults.second_blow(2.21, 0.3, f"{KEEP_OR_EXCLUDE}.", grows=True),
        decay_faults.second_blow(2.21, 0.3, f"{KEEP_OR_EXCLUDE}.", grows=False),
        decay_faults.interrupted(2.21, f"{KEEP_OR_EXCLUDE}."),
        decay_faults.steady_line("50.01", 0.03),
        decay_faults.windowed(0.8, 0.05),
    ],
    "loop_faults": [
        loop_faults.degrading(0.001, 12, 0.2, KEEP, falls=True),
        loop_faults.degrading(0.001, 12, 0.2, KEEP, falls=False),
        loop_faults.lopsided(1.4, positive=True),
        loop_faults.lopsided(1.4, positive=False),
        loop_faults.begins_away(0.1),
        loop_faults.drifts(0.1),
        loop_faults.off_centre(loop_faults.begins_away(0.1), ""),
        loop_faults.free_travel(0.0001, 0.001, '"iwan4", "gap"'),
    ],
    "record_faults": [
        record_faults.unequal_lengths("`input` has 4096, `force` has 4000"),
        record_faults.masked_or_left_out(EXCLUDE),
        record_faults.not_finite(3, 4096, "12, 13", f"{KEEP_OR_EXCLUDE}."),
        record_faults.masked(3, 4096),
        record_faults.beyond_measurement(12, 12000000000000.0),
        record_faults.constant(0.0, EXCLUDE, toggles=True),
        record_faults.constant(0.0, EXCLUDE, toggles=False),
        record_faults.few_levels(40, 256),
        record_faults.implausible("displacement", 12.0, "mm or um"),
        record_faults.lost_samples(3, 4096, -9999.0, 2.5, -1.2, 1.3, f"{KEEP_OR_EXCLUDE}."),
        record_faults.clipped(0.021, "1.200-1.300 s", " and 2 more", f"{KEEP_OR_EXCLUDE}."),
        record_faults.stopped(4.213, KEEP),
        record_faults.gaps("1.2-1.3 s", "", 3, f"{KEEP_OR_EXCLUDE}."),
        record_faults.swapped(12.0),
        record_faults.incoherent(0.31),
        record_faults.outside_band(119.0, 15.0, 23.0, 6.26),
        record_faults.unresolved(18.8, 0.1, 10.0, 0.08),
        record_faults.negative_gain("displacement"),
        record_faults.other_size(1000.0),
        record_faults.noisy_drive("input", 3.1, "velocity"),
    ],
    "response_faults": [
        response_faults.drifting("Tone 18.8 Hz", 0.03),
        response_faults.buried_harmonic("Tone 18.8 Hz", 1e-08, 2e-08),
        response_faults.few_lines(3, 4),
        response_faults.locked_phase(-90.0),
        response_faults.active(["its phase rises with frequency"], ["`conjugate = true`"]),
        response_faults.in_degrees(89.0),
        response_faults.loop_gives_energy(0.2),
        response_faults.undecaying(1.2),
        response_faults.offset(1.3),
        response_faults.already_moving(0.4),
        response_faults.unlike_level(26.0, "input", 0.026, 0.01, "V"),
        response_faults.put_band(15.0, 23.0),
        response_faults.without_band(response_faults.STATE_BAND),
        response_faults.several_modes(0.4, 15.0, 23.0),
    ],
}
