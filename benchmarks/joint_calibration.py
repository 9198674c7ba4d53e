"""Do the joint posterior's intervals hold the truth as often as they say?

Prints one table: for sweeps repeated on one day, at the laser's noise and with 1 % noise, and for
the mixed campaign (noise, tones, stepped sine, sweeps, decays, a forced loop), the mean and the
standard deviation of the truth's z-scores over many campaigns of the virtual rig, and the p-value
of a Kolmogorov-Smirnov test against the standard normal.

    python benchmarks/joint_calibration.py [number of campaigns]
"""

import sys

import jbw

jbw.enable_x64()

from jbw.study.calibration import calibrate  # noqa: E402

CASES = {
    "24 repeats, 50 um/s": {"repeats": 24},
    "4 repeats, 1 % noise": {"repeats": 4, "noise_ratio": 0.01},
    "every kind of test, 2 repeats, 2 % noise": {
        "campaign": "mixed",
        "repeats": 2,
        "noise_ratio": 0.02,
    },
}


def main():
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    for name, options in CASES.items():
        result = calibrate(
            number,
            report=lambda done: print(f"\r{done}/{number}", end="", file=sys.stderr),
            **options,
        )
        print(f"\n{name}, {number} campaigns: chi2/dof {result.chi_square.mean():.4f}, ", end="")
        print(f"worst k-hat {result.khat.max():.2f}")
        for i, parameter in enumerate(result.names):
            z = result.z[:, i]
            p = result.p_values[parameter]
            print(f"  {parameter:8s} z mean {z.mean():+.2f} sd {z.std(ddof=1):.2f} KS p {p:.3f}")


if __name__ == "__main__":
    main()
