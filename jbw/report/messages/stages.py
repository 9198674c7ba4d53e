"""Progress messages of an identification, and names of its parts that may fail independently."""

from collections.abc import Sequence

from jbw.report.messages.message import listed
from jbw.report.messages.remedies import put

READING_RECORDS = "Measuring frequency and damping of the records without a model"
DRAWING = "Drawing the posterior"
SINGLE_RECORDS = "Computing the likelihood of every record, and its prediction from the prior"
FITTING_SHARED = "Fitting all laws with the same omega_n and zeta for all sessions"
COMPUTING_JOINT = "Computing the joint's backbone with bands, and its loops"
SAVED = "Saved. Repeat the command to continue."

# parts of a result, each the subject of a sentence that says why it is missing
ANSWER_OF_FIT = "The result of the fit alone"
IDENTIFIABILITY = "The study of identifiability"
WITHOUT_FORM = "The estimate of frequency and damping without assuming a law"
OUTSIDE_BAND = "The contribution of the modes outside the band"
ROUTES = (
    "The comparison of Steps 2 to 4 of Teloli et al. with the joint posterior of all parameters"
)
TIED = "The evidence that several joints have one law"
KERNEL = "The comparison of the third-order kernel with the model"
ENERGY = "The running mean of the response energy in the sweeps"
TESTS = "The comparison of the tests with the model"
BACKBONE = "The backbone"
RECORD_LIKELIHOOD = "The likelihood of single records"

FREE_DECAYS = "Free decays: the joint, identified from free decays alone"
FREE_POSTERIOR = "The posterior of the free decays alone"
STEP_4 = "Step 4: gamma alone, with the results of the earlier steps fixed"
STEP_3_MEANS = "Step 3: means of zeta, alpha and delta, by NUTS"
WITHOUT_KIND = "fit without one kind of test, %d of %d"
WITHOUT_RUN = "fit without run %d of %d"
PRIOR_POINTS = "predictions at %d points drawn from the prior"
FURTHER_START = "additional start %d of %d"
REWEIGHTING = "fit and importance weights, round %d of at most %d"
NONE_HELD_OUT = "No test is held out: this result uses all tests."
FITTING_FOR_USE = "Fitting all tests, including the held-out ones"


def little_address_space(limit_gib: float, needed_gib: float) -> str:
    """Return the warning that a limit on the address space may end the process."""
    return (
        f"The address space of this process is limited to {limit_gib:.2g} GiB, but compiling may "
        f"need {needed_gib:g} GiB; without them the process ends. Raise the limit: "
        "ulimit -v unlimited."
    )


def unkept_code(folder: str, reason: str) -> str:
    """Return the warning that compiled code cannot be kept in a folder."""
    return (
        f"Compiled code cannot be kept in {folder}: {reason}. The results are the same, but every "
        "command compiles again. Name a folder with write permission: "
        "export JAX_COMPILATION_CACHE_DIR=FOLDER."
    )


DAMAGED_PROGRAM = (
    "A stored program in jbw's cache folder is damaged. It is compiled again, and the results are "
    "the same."
)


def design(step: int) -> str:
    """Return the progress message for reading what a step of Teloli et al. needs."""
    return f"Reading the design of Step {step} from the campaign"


def scoring(law: str, num_sessions: int, *, by_fit: bool) -> str:
    """Return the progress message on scoring a law, with the number of sessions and the method."""
    if num_sessions == 1:
        return f"{law}: one session, judged by its {'fit' if by_fit else 'evidence'}"
    method = " by fits alone" if by_fit else ", and the evidence"
    return f"{law}: {num_sessions} sessions, each predicted from the others{method}"


def points(count: int, coordinates: str) -> str:
    """Return the progress message on how many points are evaluated for a parametrisation."""
    return f"parametrisation by {coordinates}: evaluating the model at {count} points"


CHAINS = "chains that start from the present draws"


def drawing_figures(page: str) -> str:
    """Return the progress message for drawing figures and writing a report."""
    return f"Drawing figures and writing {page}"


def drawing_records(folder: str) -> str:
    """Return the progress message for drawing each test's first record into a folder."""
    return f"Drawing a figure of the first record of every test in folder {folder}"


def starts(count: int) -> str:
    """Return the phrase on the number of starts from which fits run in parallel."""
    return "1 start" if count == 1 else f"{count} starts in parallel"


def later_round(what: str, number: int) -> str:
    """Return the name of a posterior that is sampled again, with the number of the round."""
    return f"{what}, round {number}: drawn again, because chains disagreed or draws were too few"


def evaluated(line: str, count: int) -> str:
    """Return a line on a running stage, with the number of model evaluations in this stage."""
    return f"{line}, {count:,} model evaluations"


def effective(size: float, needed: float) -> str:
    """Return the phrase on the effective draws so far and the number needed."""
    return f"{size:,.0f} effective draws; at least {needed:,.0f} are needed"


def finished_before(verdict: str) -> str:
    """Return the message for a campaign that finished earlier, with its verdict."""
    return f"was finished earlier, verdict {verdict}"


def _groups(count: int, steps: int) -> str:
    groups = "1 data group" if count == 1 else f"{count} data groups"
    return f"{groups}, {steps:,} time steps per simulation" if steps else groups


def joint_posterior(count: int, steps: int) -> str:
    """Return the progress message for the joint posterior, with the size of its data."""
    return f"Joint posterior: all parameters from {_groups(count, steps)}"


def long_fit(seconds: float, tests: Sequence[str], rate: float | None) -> str:
    """Return the sentence that a fit will take long, with the line that shortens it."""
    keep = "Keep only the seconds that contain the motion, with the key `span`."
    lower = (
        ""
        if rate is None
        else f"Lower the sampling rate of these records. {put('[test]', 'resample', rate)} "
    )
    return (
        f"This fit will take about {seconds / 60:.2g} minutes of one processor core, most of them "
        f"for {listed(tests)}. {lower}{keep}"
    )


def kernel(count: int) -> str:
    """Return the progress message for the third-order kernel at a number of frequencies."""
    return f"Step 3: third-order kernel at {count} frequencies"


def least_squares(count: int, steps: int) -> str:
    """Return the progress message for least squares, with the size of its data."""
    return f"Least squares: all parameters from {_groups(count, steps)}"


def line_fit(test: str) -> str:
    """Return the progress message for the FRF fit to a test, Step 2 of Teloli et al."""
    return f"Step 2: oscillator fitted to test `{test}`"


def fitting_as(law: str) -> str:
    """Return the progress message on the law whose noise weights are used for all laws."""
    return f"Fitting all laws with the noise weights of {law}, the law with the smallest residual"
