"""Words of the field and columns of tables, and what they mean."""

WORDS: dict[tuple[str, ...], str] = {
    ("verdict", "status", "badge", "usable", "not assessed"): (
        "Whether a result can be used: ok; usable (within an error that is stated); failed; not "
        "assessed (something could not be looked at). It answers three questions: convergence "
        "(`sampling`), model adequacy (`law`) and identifiability (`knowledge`). Of a record it "
        "is ok, warning or error; of a run in a list done or failed."
    ),
    ("sampling",): (
        "The first question of a verdict: did the computation converge? R-hat and effective "
        "sample sizes answer it."
    ),
    ("law", "laws"): (
        "The restoring force of a joint as a formula, such as Bouc-Wen's; `jbw laws` compares "
        "them. In a verdict, the second question: does the model follow the data?"
    ),
    ("knowledge",): (
        "The third question of a verdict: do the data identify the parameters, or is the answer "
        "that of the prior?"
    ),
    ("first answer", "quick", "laplace"): (
        "What `jbw identify --quick` ends with: the least-squares fit, and intervals of a "
        "Gaussian with the fit's covariance (Laplace's approximation). No draw is made, so that "
        'the verdict is "not assessed".'
    ),
    ("posterior", "draws"): (
        "The probability of the parameters given the data, as a set of draws. A column `draws` "
        "counts them."
    ),
    ("prior", "prior bounds", "box"): (
        "The probability of a parameter before the data: by default uniform between two bounds, "
        "together a box. `[identify.prior]` states others. A parameter at a bound is truncated by "
        "the prior: the data allow values beyond it."
    ),
    ("identified", "not identified", "grade"): (
        "Whether the data narrow a parameter. Where they do not, its interval is that of the "
        "prior, and no result of the test."
    ),
    ("strain energy, in full stick",): (
        "Energy share of a joint in a mode, k_j h_ji^2 / omega_i^2: the part of the mode's strain "
        "energy that the joint holds in full stick. It bounds what the joint can do to the mode."
    ),
    ("strain energy, at that motion",): (
        "The joint's part of the mode's strain energy at the largest motion of the mode that tests "
        "drove, in the shape that the joints leave it, with its 99 % interval."
    ),
    ("losses of all joints", "loss share"): (
        "The part of the energy that all joints lose in a cycle of a mode, at its largest motion, "
        "which one joint takes: median and 99 % interval."
    ),
    ("softening of all joints", "softening share"): (
        "The part of the change of a mode's squared frequency by all joints, at its largest "
        "motion, which one joint makes: median and 99 % interval."
    ),
    ("by itself",): (
        "Whether what one of several joints does is known within a factor of two, in the mode "
        "that shows it best; else the tests tell only what it does together with others."
    ),
    ("product", "products"): (
        "alpha*delta sets how fast the frequency falls with amplitude at small amplitude, and "
        "alpha*gamma how fast the damping rises. Weak motion identifies the products where it "
        "does not identify their factors."
    ),
    ("Step 2",): (
        "The linear reading of a noise test: natural frequency and damping ratio at low amplitude."
    ),
    ("Step 3",): (
        "The paper's reading of the third-order kernel H3 from tones: zeta, alpha and delta."
    ),
    ("Step 4",): (
        "The paper's fit of gamma alone to sweeps, with everything of Step 3 held. The joint "
        "posterior updates all parameters together; where both are there, the joint one is the "
        "result."
    ),
    ("joint posterior", "joint"): (
        "The posterior of all parameters from all fitted tests together: the main result of a "
        "run. Elsewhere the joint is the bolted joint itself."
    ),
    ("held out", "hold_out"): (
        'A test that no fit has seen, kept to check predictions. `hold_out = ["name"]` in '
        "`[identify]`."
    ),
    ("fitted", "used as"): ("Whether a test was fitted or held out."),
    ("residual", "coloured residual"): (
        "The measured response less the predicted one. It is coloured where neighbouring samples "
        "are correlated: then it holds a discrepancy of the model, and not the noise alone."
    ),
    ("offset", "offsets", "run effects"): (
        "The natural frequency and the damping ratio of a session, or an assembly, less those of "
        "all."
    ),
    ("leave one out", "leave-one-out"): (
        "A fit without one session. Where it moves the parameters far, that session contradicts "
        "the others."
    ),
    ("effective number of samples", "worth"): (
        "Samples of a coloured residual are correlated and count as fewer independent ones, so "
        "that intervals do not become too narrow."
    ),
    ("direction", "directions", "direction, strongest first"): (
        "A combination of parameters, mostly a product of powers such as alpha*delta, that the "
        "data know by itself. The strongest is known best. All are counted in logarithms of "
        "parameters that cannot be zero."
    ),
    ("information", "information / prior's"): (
        "How much more precise the data know a direction than the prior does: the ratio of the "
        "inverse variances."
    ),
    ("sd / prior's", "sd / prior's, by the fit"): (
        "Standard deviation after the data over that of the prior: 1 says that the data add "
        "nothing."
    ),
    ("contraction", "contraction, by the draws"): (
        "1 less the variance of the draws over the prior's: 100 % is known from the data, 0 % is "
        "the prior."
    ),
    ("follows its bounds", "follows its bounds, in sds"): (
        "How far the mean moves, in standard deviations, when a tenth of a prior's range is cut "
        "off at either end. A parameter that is its prior moves by 0.17."
    ),
    ("profile", "99 % interval of the profile"): (
        "The range of a parameter over which the others can make up for it within the noise: by "
        "fits, not by draws."
    ),
    ("coordinates", "logarithms", "ridge", "valley"): (
        'The variables in which a posterior is drawn. Logarithms suit positive parameters; "along '
        'the ridge" follows a combination that the data leave open; "along the valley" follows a '
        "curved one. The result does not depend on the choice, the time does."
    ),
    ("parametrisation",): (
        "Another set of parameters for the same law, such as products in place of factors."
    ),
    ("parameter", "parameter or combination", "parameters", "quantity"): (
        "The name of a number of the model, as `jbw explain alpha` says it. A column `parameters` "
        "counts those of a law."
    ),
    ("unit",): ("The unit of a quantity. In tables of several joints, the name of one of them."),
    ("mean", "middle", "joint: mean", "cut: mean", "A", "B"): (
        "Mean of the draws, mostly with the 99 % interval in brackets. A and B are the two runs "
        "that `jbw diff` compares."
    ),
    ("sd", "joint: sd", "cut: sd", "std"): (
        'Standard deviation. "cut" is the paper\'s order, in which Steps 3 and 4 hold what came '
        "before."
    ),
    ("CV", "sd / value, by the fit"): (
        "Coefficient of variation: standard deviation over mean. To 10 % a parameter counts as "
        "known, to 30 % as known roughly."
    ),
    ("MAP", "fit"): (
        "The best single value: the draw of the highest posterior density; of a fit, its optimum."
    ),
    ("99 % interval", "interval", "model [mJ/kg] 99 % parameter band"): (
        "The range that holds 99 % of the draws, 0.5 % beyond either end."
    ),
    ("KL", "KL [nats]"): (
        "Kullback-Leibler divergence of the posterior from the prior: how much the data say of "
        "one parameter, in nats. 0 is nothing; 1.3 narrows the range about fourfold."
    ),
    ("nats", "gain [nats]", "information gain"): (
        "The unit of information and of log likelihoods, by natural logarithms; 1 nat is 1.44 "
        "bits. A test that gains 1 nat narrows what is known by a factor of 2.7."
    ),
    (
        "ESS",
        "ESS bulk / tail",
        "ESS bulk",
        "ESS tail",
        "ESS/s",
        "ESS/s cold",
        "min ESS",
        "effective",
        "effective draws",
    ): (
        "Effective sample size: how many independent draws the correlated ones are worth, for "
        "means (bulk) and for the ends of intervals (tail). A verdict wants 400. ESS/s is that "
        "over the time; cold counts compiling too."
    ),
    ("R-hat", "max R-hat"): (
        "How far chains disagree: 1 is agreement, above 1.01 they have not converged."
    ),
    ("k-hat", "Pareto k"): (
        "How far weighed draws rest on a few of them: below 0.7 their means can be trusted. "
        "`arviz.loo` reports one for every record."
    ),
    ("divergence",): ("A step of NUTS that failed because the posterior bends too sharply there."),
    ("AMIS", "weighed points", "importance sampling"): (
        "Draws of an approximation that are weighed to become those of the posterior, in rounds "
        "that improve it."
    ),
    ("NUTS",): (
        "A sampler that follows the gradient of the posterior: few draws are wasted, each costs "
        "many evaluations."
    ),
    ("elliptical slice", "slices"): (
        "A sampler without gradients for posteriors that are nearly Gaussian about a fit."
    ),
    ("evidence", "log evidence"): (
        "How well a law predicts the data before any parameter is fitted. Differences above about "
        "5 nats decide."
    ),
    ("log score", "elpd", "LOO"): (
        "How well each test is predicted by fits that have not seen it, summed, in nats. Larger "
        "is better."
    ),
    ("sampler",): ("How the draws are made, such as AMIS or NUTS."),
    ("evaluations",): ("How often the model was solved."),
    ("warm [s]", "cold [s]"): (
        "Time of a sampler with everything compiled before, and with nothing."
    ),
    ("furthest [MCSE]", "MCSE", "distance"): (
        "Monte Carlo standard error: what a mean is uncertain by because draws are few. Distances "
        "between samplers of more than 4 of them are no chance."
    ),
    ("p (ECDF)", "p (chi2)", "99 % holds", "of which", "to", "ranks"): (
        "Columns of `jbw sbc`: probabilities of the ranks of simulated truths if intervals are "
        "right (small is bad), and the part of 99 % intervals that hold the truth, with its own "
        "interval from one end to the other."
    ),
    ("weight",): (
        "The share that a law has in predictions by all laws, by how well each predicts tests "
        "that it has not seen."
    ),
    (
        "fit [%]",
        "left out [%]",
        "highest [%]",
        "other kinds [%]",
        "held out [%]",
        "beyond [%]",
        "linear by run [%]",
    ): (
        "Columns of `jbw laws`, errors over the rms of the records: of the fit; of each test by a "
        "fit without it; of the loudest level by a fit without it; of the kind of test that the "
        "other kinds predict worst; of tests held out; of those beyond the motion fitted; and of "
        "the best linear oscillator of each run by itself, which no law can beat by much."
    ),
    ("load", "median [99 %]"): (
        "Columns of `jbw predict` under other loads: a sine of one level, a random profile or a "
        "shock; and the median of a quantity over the draws with its 99 % interval."
    ),
    ("the same, own frequency", "the same, with the record's own frequency"): (
        "The error of a free decay where each record may have a frequency of its own, as a "
        "temperature shifts it: what the law misses beside that."
    ),
    ("answer",): ("Whether the data tell a law from the best one: same, worse or not told apart."),
    ("test", "kind", "level", "record", "role", "run", "name", "test and repeats"): (
        "A test is one excitation of one kind at one level (amplitude of the source, in its "
        "unit); its records are the repeats. A role says what a channel is, such as velocity. A "
        "run is a session: tests without anything being dismantled between them; elsewhere the "
        "folder of a result."
    ),
    ("records", "repeats"): ("How many records a test has."),
    ("fs",): ("Sampling frequency [Hz]."),
    ("channel",): ("A measured series in a file."),
    ("truth",): ("The value of the virtual rig, where a joint was simulated."),
    ("z",): (
        "How far the mean is from the truth, in standard deviations. Beyond 3 something is wrong."
    ),
    (
        "error",
        "error / rms of the record",
        "RMS error / rms of the record",
        "nrmse",
        "best laws",
        "s",
    ): (
        "Error of a prediction: rms of measured less predicted, over the rms of the record. The "
        "law predicts by itself: a model discrepancy widens the bands and does not change the "
        "error. In a list of runs it is the message of a failure. A column `s` has times in "
        "seconds."
    ),
    (
        "the same, best linear oscillator",
        "the same, best cubic oscillator",
        "best cubic oscillator",
        "best linear",
    ): (
        "The error of the best oscillator without hysteresis, for comparison: what the joint's "
        "law must beat."
    ),
    ("inside the 99 % predictive band", "inside the 99 % band", "inside the band", "coverage"): (
        "How many of the measured values lie within the 99 % band. About 99 % is right."
    ),
    (
        "half width",
        "its half width",
        "half width of the band / rms of the record",
        "its half width / rms of the record",
    ): (
        "Half the width of the band over the rms of the record. A wide band holds everything and "
        "says little."
    ),
    ("peak displacement [m]", "peak [m]", "motion", "motion [mm]", "at", "amplitude"): (
        "The largest displacement of a test, or the amplitude at which something is compared."
    ),
    ("of fitted", "beyond fitted", "beyond", "extrapolation"): (
        "The largest displacement of a test over that of the fitted tests. Beyond 1 a prediction "
        "extrapolates."
    ),
    ("frequency", "frequency [Hz]"): (
        "Natural frequency at the amplitude of the test, read without a joint's model."
    ),
    ("damping", "damping [%]", "damping ratio"): (
        "Damping ratio over the critical one, in per cent; Q is 1 over twice it."
    ),
    ("best linear leaves", "linear residual", "residual of a linear fit"): (
        "The part of a record that no linear oscillator follows."
    ),
    ("third harmonic",): (
        "Motion at three times the frequency of a tone, over that at the tone: a sign of a "
        "nonlinear joint."
    ),
    ("secant stiffness", "secant stiffness [N/m]"): (
        "Force over displacement between the ends of a loop."
    ),
    (
        "loss per cycle",
        "loop area",
        "measured [mJ/kg]",
        "model [mJ/kg] median",
        "bands meet",
        "restoring force",
    ): (
        "Energy that a closed loop of force against displacement takes. Table of loops: measured "
        "and predicted area per kilogram of modal mass, by restoring force, and whether the bands "
        "of both have values in common."
    ),
    ("joint sd / cut sd", "cut less joint, over the joint's sd"): (
        "How the paper's order of steps compares with updating all parameters together."
    ),
    ("A - B", "P(A > B)"): ("Difference of two runs, and the probability that it is positive."),
    (
        "scatter between units [%]",
        "between runs [%]",
        "power of torque",
        "new unit",
        "new assembly",
        "P(as far off)",
        "enters by",
        "torque [N m]",
        "torque",
        "sequence",
        "temperature [degC]",
        "assembly",
        "torques x assemblies",
    ): (
        "Columns of a population: scatter of a parameter between units and between their "
        "sessions, its power of the tightening torque, what the next unit will be (with its "
        "torque, sequence of tightening and temperature), how unusual a unit is, and which runs "
        "stand for it."
    ),
    ("alarm", "change", "number", "T^2", "threshold", "unchanged"): (
        "Columns of `jbw watch`: number of the record, its squared distance from the joint as it "
        "was (Hotelling's T^2), the threshold that the rate of false alarms asks for, the "
        "probability that nothing has changed, and the alarm."
    ),
    ("input", "time", "CV worst"): (
        "Columns of `jbw plan`: amplitude of the source, duration of the test, and the "
        "coefficient of variation that a parameter is expected to have after it, in the worst "
        "tenth of the joints that are still possible."
    ),
    ("backbone",): (
        "Natural frequency against amplitude of the free motion. As a kind of test "
        "(`backbone`): points at which a controller holds the phase of the displacement, "
        "at -90 degrees by default, with their frequency, force and amplitude."
    ),
    ("curve", "S-curve", "phase-locked", "locked_phase", "unstable branch"): (
        "Kind of test `curve`: points at which a controller holds the amplitude, in the order "
        "measured. Against the force they make S-curves, whose middle part is unstable under a "
        "force that is held. At such a point the amplitude is known; the model predicts the force, "
        "and either the phase at the measured frequency or the frequency at the held phase. No "
        "point then has another branch to jump to."
    ),
    ("mode",): (
        "A natural frequency of the structure with its shape and damping. With matrices the modes "
        "are those of the joints in full stick."
    ),
    ("swept",): "Modes that a test of the campaign excites: they tell joints apart.",
    ("cycle", "cycles"): "The part of a loop from one largest displacement to the next.",
    ("work [J]",): "Energy that one cycle of a loop takes.",
    ("equivalent damping",): (
        "Damping ratio of the linear spring and damper that take the same work in a cycle: the "
        "work over 2 pi times the stiffness and the squared amplitude."
    ),
    ("stiffness over the first of this amplitude",): (
        "Secant stiffness of a cycle over that of the first cycle of equal amplitude. Below 1 the "
        "joint degrades."
    ),
    ("share",): ("A part: of the stiffness that slips, of the draws, or of the response."),
    ("CHECK",): (
        "Mark of `jbw init` on a line of a campaign file that the records do not tell. Look at it "
        "before identifying."
    ),
    ("session",): (
        "A day, or a shift, in which nothing was changed: `run` in a `[[test]]` names it. "
        "Sessions may have offsets of natural frequency and damping of their own."
    ),
    ("remark",): (
        "What else is to be known of a row, such as how many of a test's repeats were fitted."
    ),
    ("why not",): (
        "Why a law was not compared with the others: its fit failed, or it is another law by "
        "construction."
    ),
}


def words() -> dict[str, str]:
    """Return a dictionary from each word or column heading, in lower case, to its meaning."""
    return {name.lower(): meaning for names, meaning in WORDS.items() for name in names}
