"""Labels and titles of figures."""

COMMON_BAND = "99 % band: parameters alone"
REPEATS_BAND = "99 % band of the measured repeats"
REPEATS_MEAN = "measured, mean of a test's repeats"
REPEATS_POOLED = "measured, pooled over a test's repeats"
LOOP_BAND = "99 % band of the measured loop, from the uncertainty of ζ and gain"
LESS_SECANT = "restoring force minus its secant line [N/kg]"
LINEAR_RESIDUAL = "residual of a linear oscillator"
PHASE_LESS_MEDIAN = "arg H₃ minus its median [°]"

DIRECTIONS = "Directions from the fit, best determined first"
BEFORE_SAMPLING = "from the fit, before sampling"
OVER_PRIOR = "standard deviation / that of the prior [-]"

ONE_MODE = "one mode, per unit mass"
OVER_MODE = "|q of each mode / q of this mode| [-]"
SLIP = "effect of slip on the joint's hysteretic force"

STEP_3_PUBLISHED = "Step 3, random walk as published"
STEP_4_PUBLISHED = "Step 4, γ alone, random walk as published"
STEP_4_NUTS = "Step 4, γ alone, NUTS"
STEP_3_BOX = "Step 3, within the prior box"
DENSITY = "posterior density / prior density [-]"
DRAW = "draw n of a chain [-]"
RUNNING_MEAN = "conv(n) / its last value [-]"
TRACES = "traces, one line per chain"
RANKS = "ranks of draws, in 20 bins"
RANK = "rank among all draws [-]"

DISTANCE = "distance of the means [standard deviations of the posterior]"
SPEED = "effective draws per second, slowest parameter"
RATE = "effective draws per second [1/s]"
UNIFORM_RANKS = "simultaneous 99 % band for uniform ranks"

MODE = "mode [-]"
LOSS_SHARE = "share of the losses of all joints"
ISOMETRIC = ("x and y, isometric", "height, isometric")
MOTION, FORCE, FORCE_LESS_SECANT = "motion", "force", "force minus secant"
MEDIAN_FREE, MEDIANS_STUCK = "median, free mode shape", "stuck mode shape, at the medians"
STUCK_SHAPE, FREE_SHAPE = "median, stuck mode shape", "free mode shape, at the medians"
IDENTIFIED, UNIDENTIFIED = "identified", "unidentified"


def mode_at(mode: int, hz: float) -> str:
    """Return the label of a mode: its number and frequency."""
    return f"mode {mode}, {hz:.4g} Hz"


def energy_of(shares: str) -> str:
    """Return the label for the joints' shares in a mode's strain energy."""
    return f"strain energy: {shares}"


def secant(stiffness: str, unit: str) -> str:
    """Return the label of a loop's secant, the line from tip to tip, with its slope."""
    return f"secant {stiffness} {unit}"


def model_residual(error: str) -> str:
    """Return the title of a record's residual, with the model's RMS error relative to its rms."""
    return f"residual of the model: {error}"


def taken_by_slip(stiffness: str) -> str:
    """Return the label of an axis that shows the hysteretic force minus its elastic part."""
    return f"force lost by slip, Z − {stiffness} y"


def full_stick(stiffness: str) -> str:
    """Return the label of the line of a fully stuck joint, with the name of its stiffness."""
    return f"fully stuck, Z = {stiffness} y"


def modal_amplitude(unit: str, several_joints: bool) -> str:
    """Return the axis label of an amplitude: of the mode if `several_joints`, else at the joint."""
    where = "of the mode" if several_joints else "at the joint"
    return f"amplitude {where} [{unit}]"


def first_point_amplitude(unit: str) -> str:
    """Return the axis label of a mode's amplitude at the first measured point."""
    return f"amplitude at the first point [{unit}]"


def fold(mode: str, amplitude: str) -> str:
    """Return the title of a backbone that ends early, with the two possible reasons."""
    return f"{mode}: ends at {amplitude}\n(fold or too many turns)"


def loop_areas(count: int, largest: str) -> str:
    """Return the label of the flow diagram's loops, with their number and largest area error."""
    return f"{count} loops, error of the model's loop areas at most {largest}"


def less_mean(parameter: str, reference: str) -> str:
    """Return the title of a panel that compares a parameter's means between samplers."""
    return (
        f"{parameter}: mean minus the mean of sampler {reference}; bars: two Monte Carlo "
        "standard errors"
    )
