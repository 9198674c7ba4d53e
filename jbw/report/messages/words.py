"""Words of the field and columns of tables, with their meanings."""

WORDS: dict[tuple[str, ...], str] = {
    ("verdict", "status", "badge", "usable", "not assessed"): (
        "Whether a result can be used: ok; usable (within an error that is stated); failed; not "
        "assessed (a check could not be made). It answers three questions: convergence "
        "(`sampling`), model adequacy (`law`) and identifiability (`knowledge`). The status of a "
        "record is ok, warning or error; that of a run in a list is done or failed."
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
        "The third question of a verdict: do the data identify the parameters, or does the prior "
        "determine the answer?"
    ),
    ("first answer", "quick", "laplace"): (
        "The result of `jbw identify --quick`: the least-squares fit, and intervals of a Gaussian "
        "with the covariance of the fit (Laplace's approximation). The posterior is not sampled; "
        'therefore the verdict is "not assessed".'
    ),
    ("posterior", "draws"): (
        "The probability of the parameters given the data, as a set of draws. A column `draws` "
        "states the number of draws."
    ),
    ("prior", "prior bounds", "box"): (
        "The probability density of a parameter before the data are used. By default it is uniform "
        "between two bounds; the bounds of all parameters form a box. State other priors under "
        "`[identify.prior]`. If the prior truncates a parameter at a bound, the data allow values "
        "beyond the bound."
    ),
    ("identified", "not identified", "grade"): (
        "Whether the data constrain a parameter. If they do not, its interval is that of the "
        "prior, and not a result of the test."
    ),
    ("strain energy, in full stick",): (
        "Energy share of a joint in a mode, k_j h_ji^2 / omega_i^2: the part of the mode's strain "
        "energy that lies in the fully stuck joint. It bounds the effect of the joint on the mode."
    ),
    ("strain energy, at that motion",): (
        "The joint's share of the mode's strain energy at the largest measured motion of the "
        "mode, in the mode shape at that motion, with its 99 % interval."
    ),
    ("losses of all joints", "loss share"): (
        "The share of one joint in the energy that all joints dissipate in a cycle of a mode "
        "at its largest motion: median and 99 % interval."
    ),
    ("softening of all joints", "softening share"): (
        "The share of one joint in the change of a mode's squared frequency by all joints, at "
        "the largest motion of the mode: median and 99 % interval."
    ),
    ("by itself",): (
        "Whether the effect of one of several joints is known within a factor of two, in the "
        "mode that shows it best. If not, the tests determine only its effect together with "
        "the effects of other joints."
    ),
    ("product", "products"): (
        "alpha*delta sets how fast the frequency falls with amplitude at small amplitude, and "
        "alpha*gamma how fast the damping rises. Weak motion identifies the products where it "
        "does not identify their factors."
    ),
    ("Step 2",): (
        "The linear fit of a noise test: natural frequency and damping ratio at low amplitude."
    ),
    ("Step 3",): (
        "The fit of Teloli et al. to the third-order kernel H3, which is measured by tones. It "
        "determines zeta, alpha and delta."
    ),
    ("Step 4",): (
        "The fit by which Teloli et al. determine gamma alone from sweeps, with the results of "
        "Step 3 fixed. The joint posterior updates all parameters together; if both results "
        "exist, use the joint posterior."
    ),
    ("joint posterior", "joint"): (
        "The joint posterior is the posterior of all parameters from all fitted tests together: "
        'the main result of a run. In all other places, "joint" means the bolted joint.'
    ),
    ("held out", "hold_out"): (
        "A test that is not fitted, but kept to check predictions. State it by "
        '`hold_out = ["name"]` in `[identify]`.'
    ),
    ("fitted", "used as"): ("Whether a test was fitted or held out."),
    ("residual", "coloured residual"): (
        "The measured response minus the predicted one. It is coloured if neighbouring samples are "
        "correlated: then it contains a discrepancy of the model in addition to the noise."
    ),
    ("offset", "offsets", "run effects"): (
        "The deviation of the natural frequency and the damping ratio of one session, or one "
        "assembly, from the values that all sessions share."
    ),
    ("leave one out", "leave-one-out"): (
        "A fit without one session. If this fit moves the parameters far, that session contradicts "
        "the others."
    ),
    ("effective number of samples", "worth"): (
        "The number of independent samples that the correlated samples of a coloured residual are "
        "worth. It prevents intervals from becoming too narrow."
    ),
    ("direction", "directions", "direction, strongest first"): (
        "A combination of parameters, mostly a product of powers such as alpha*delta, that the "
        "data determine separately. The strongest direction is determined best. All directions "
        "are computed in logarithms of parameters that cannot be zero."
    ),
    ("information", "information / prior's"): (
        "How much more precisely the data determine a direction (a combination of parameters) "
        "than the prior does: the ratio of the inverse variances."
    ),
    ("sd / prior's", "sd / prior's, by the fit"): (
        "Standard deviation of the posterior / that of the prior: 1 means that the data add "
        "nothing."
    ),
    ("contraction", "contraction, by the draws"): (
        "1 minus the ratio of the draws' variance to the prior's. 100 %: determined by the data; "
        "0 %: unchanged from the prior."
    ),
    ("follows its bounds", "follows its bounds, in sds"): (
        "How far the mean moves, in standard deviations, when a tenth of a prior's range is cut "
        "off at either end. A parameter that the data do not constrain moves by 0.17."
    ),
    ("profile", "99 % interval of the profile"): (
        "The range of a parameter over which the other parameters can compensate for it within "
        "the noise. It comes from fits, not from draws."
    ),
    ("coordinates", "logarithms", "ridge", "valley"): (
        "The variables in which a posterior is sampled. Logarithms suit positive parameters; "
        '"along the ridge" follows a combination that the data do not determine; '
        '"along the valley" follows a curved combination. The choice changes the computing time, '
        "but not the result."
    ),
    ("parametrisation",): (
        "Another set of parameters for the same law, such as products in place of factors."
    ),
    ("parameter", "parameter or combination", "parameters", "quantity"): (
        "The name of a parameter of the model; for example, `jbw explain alpha` explains alpha. A "
        "column `parameters` contains the number of parameters of a law."
    ),
    ("unit",): (
        "The unit of the quantity in this row. In a table of several joints, `unit` is the name of "
        "the joint."
    ),
    ("mean", "middle", "joint: mean", "cut: mean", "A", "B"): (
        "Mean of the draws, mostly with the 99 % interval in brackets. A and B are the two runs "
        "that `jbw diff` compares."
    ),
    ("sd", "joint: sd", "cut: sd", "std"): (
        'Standard deviation. A column "cut" contains the standard deviation by the method of '
        "Teloli et al., whose Steps 3 and 4 fix the results of earlier steps."
    ),
    ("CV", "sd / value, by the fit"): (
        "Coefficient of variation: standard deviation / mean. A parameter counts as identified "
        "up to 10 %, and as roughly identified up to 30 %."
    ),
    ("MAP", "fit"): (
        "The best single value: the draw with the highest posterior density, or the optimum of a "
        "fit."
    ),
    ("99 % interval", "interval", "model [mJ/kg] 99 % parameter band"): (
        "The range that contains 99 % of the draws; 0.5 % lie beyond either end."
    ),
    ("KL", "KL [nats]"): (
        "Kullback-Leibler divergence of the posterior from the prior: the information of the data "
        "on one parameter, in nats. 0: no information; 1.3: the range is narrowed about fourfold."
    ),
    ("nats", "gain [nats]", "information gain"): (
        "The unit of information and of log likelihoods, from natural logarithms; 1 nat is 1.44 "
        "bits. A test that gains 1 nat narrows the uncertainty by a factor of 2.7."
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
        "means (bulk) and for the ends of intervals (tail). A verdict requires 400. ESS/s is the "
        "effective sample size per second; cold includes compiling."
    ),
    ("R-hat", "max R-hat"): (
        "How far chains disagree. 1: they agree; above 1.01: they have not converged."
    ),
    ("k-hat", "Pareto k"): (
        "How much a few draws dominate the weights of all draws. If k-hat is below 0.7, means "
        "can be trusted. `arviz.loo` reports one value for every record."
    ),
    ("divergence",): ("A step of NUTS that failed because the posterior bends too sharply there."),
    ("AMIS", "weighed points", "importance sampling"): (
        "Draws of an approximation, weighted so that they represent the posterior, in rounds that "
        "improve the approximation."
    ),
    ("NUTS",): (
        "A sampler that follows the gradient of the posterior: few draws are wasted, but each "
        "draw costs many evaluations."
    ),
    ("elliptical slice", "slices"): (
        "A sampler without gradients, for posteriors that are nearly Gaussian around the fit."
    ),
    ("evidence", "log evidence"): (
        "The probability of the data under a law, averaged over the prior of the parameters. "
        "Differences of log evidence above about 5 nats are decisive."
    ),
    ("log score", "elpd", "LOO"): (
        "The log probability of each test as predicted by fits without this test, summed over the "
        "tests, in nats. Larger is better."
    ),
    ("sampler",): ("The method that makes the draws, such as AMIS or NUTS."),
    ("evaluations",): ("The number of solutions of the model."),
    ("warm [s]", "cold [s]"): (
        "Time of a sampler when everything is compiled already (warm), and including the "
        "compilation (cold)."
    ),
    ("furthest [MCSE]", "MCSE", "distance"): (
        "Monte Carlo standard error: the uncertainty of a mean because draws are few. Distances "
        "between samplers of more than 4 such errors do not occur by chance."
    ),
    ("p (ECDF)", "p (chi2)", "99 % holds", "of which", "to", "ranks"): (
        "Columns of `jbw sbc`: probabilities of the ranks of simulated truths if intervals are "
        "right (small is bad), and the share of 99 % intervals that contain the true value, with "
        "the lower and the upper end of the confidence interval of this share."
    ),
    ("weight",): (
        "The share of a law in predictions by all laws; it depends on how well each law predicts "
        "tests that were not fitted."
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
        "Columns of `jbw laws` contain errors divided by the rms of the records. fit: error of the "
        "fit. left out: error of each test, predicted by a fit without this test. highest: error "
        "of the highest level, predicted by a fit without this level. other kinds: error of the "
        "kind of test that the other kinds predict worst. held out: error of held-out tests. "
        "beyond: error of tests beyond the fitted motion. linear by run: error of a linear "
        "oscillator fitted to each run separately, which no law can beat by much."
    ),
    ("load", "median [99 %]"): (
        "Columns of `jbw predict` under other loads: a sine of one level, a random profile or a "
        "shock; and the median of a quantity over the draws with its 99 % interval."
    ),
    ("error, own frequency", "RMS error with the record's own frequency"): (
        "The error of a free decay if each record may have its own natural frequency, as a change "
        "of temperature would cause: the remaining error of the law."
    ),
    ("answer",): (
        'Whether the data distinguish a law from the best law: "best", "worse", or "not told '
        'apart" if the data do not distinguish the two laws.'
    ),
    ("test", "kind", "level", "record", "role", "run", "name", "test and repeats"): (
        "A test is one excitation of one kind at one level (amplitude of the source, in its "
        "unit); its records are the repeats. A role states the quantity of a channel, such as "
        "velocity. In a campaign, a run is a session: tests between which nothing was dismantled. "
        "In commands, a run is the folder of a result."
    ),
    ("records", "repeats"): ("How many records a test has."),
    ("fs",): ("Sampling frequency [Hz]."),
    ("channel",): ("A measured series in a file."),
    ("truth",): ("The true value in the virtual rig, if the joint was simulated."),
    ("z",): (
        "Distance of the mean from the true value, in standard deviations. Beyond 3 something is "
        "wrong."
    ),
    (
        "error",
        "error / rms of the record",
        "RMS error / rms of the record",
        "nrmse",
        "best laws",
        "s",
    ): (
        "Error of a prediction: rms of measured minus predicted, divided by the rms of the "
        "record. It is the error of the law alone: a model discrepancy widens the bands and does "
        "not change the error. In a list of runs, the column `error` contains the message of a "
        "failed run. A column `s` contains times in seconds."
    ),
    (
        "RMS error, best linear oscillator",
        "RMS error, best cubic oscillator",
        "best cubic oscillator",
        "best linear",
    ): (
        "The error of the best oscillator without hysteresis, for comparison: the joint's law must "
        "have a smaller error."
    ),
    ("inside the 99 % predictive band", "inside the 99 % band", "inside the band", "coverage"): (
        "Percentage of the measured values inside the 99 % band. It should be about 99 %."
    ),
    (
        "half width",
        "half width of the band / rms of the record",
    ): (
        "Half the width of the band, divided by the rms of the record. A wide band contains "
        "all measured values but predicts little."
    ),
    ("peak displacement [m]", "peak [m]", "motion", "motion [mm]", "at", "amplitude"): (
        "The largest displacement of a test, or the amplitude at which something is compared."
    ),
    ("of fitted", "beyond fitted", "beyond", "extrapolation"): (
        "The largest displacement of a test, divided by that of the fitted tests. Beyond 1 a "
        "prediction extrapolates."
    ),
    ("frequency", "frequency [Hz]"): (
        "Natural frequency at the amplitude of the test, found without a model of the joint."
    ),
    ("damping", "damping [%]", "damping ratio"): (
        "Damping divided by critical damping, in per cent; the quality factor Q is 1 / (2 zeta)."
    ),
    ("best linear leaves", "linear residual", "residual of a linear fit"): (
        "The part of a record that no linear oscillator describes."
    ),
    ("scatter of repeats",): (
        "The standard deviation of a test's repeats about their mean, divided by the rms of the "
        "mean."
    ),
    ("coherence",): (
        "The share of the response's power at resonance that the source explains linearly; the "
        "share is 1 if noise and nonlinearity add nothing."
    ),
    ("third harmonic",): (
        "Motion at three times the frequency of a tone, divided by the motion at the frequency "
        "of the tone: a sign of a nonlinear joint."
    ),
    ("secant stiffness", "secant stiffness [N/m]"): (
        "Force divided by displacement, between the ends of a loop."
    ),
    (
        "loss per cycle",
        "loop area",
        "measured [mJ/kg]",
        "model [mJ/kg] median",
        "bands meet",
        "restoring force",
    ): (
        "Energy dissipated in a closed loop of force against displacement. In the table of loops: "
        "measured and predicted area per kilogram of modal mass, from the restoring force, and "
        "whether the two bands overlap."
    ),
    ("joint sd / cut sd", "(cut - joint) / joint sd"): (
        "Comparison of the steps of Teloli et al. (cut: each step fixes the results of earlier "
        "steps) with the joint posterior of all parameters."
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
        "Columns of a population: standard deviation of a parameter between units and between "
        "their sessions, its exponent of the tightening torque, the prediction for a new unit "
        "(with its torque, sequence of tightening and temperature), how unusual a unit is, and "
        "which runs represent it."
    ),
    ("alarm", "change", "number", "T^2", "threshold", "unchanged"): (
        "Columns of `jbw watch`: number of the record, its squared distance from the reference "
        "records (Hotelling's T^2), the threshold that follows from the rate of false alarms, the "
        "probability that nothing has changed, and the alarm."
    ),
    ("input", "time", "CV worst"): (
        "Columns of `jbw plan`: amplitude of the source, duration of the test, and the expected "
        "coefficient of variation of a parameter after the test, in the worst tenth of the joints "
        "that agree with the present knowledge."
    ),
    ("backbone",): (
        "Natural frequency against amplitude of the free motion. As a kind of test "
        "(`backbone`): points at which a controller holds the phase of the displacement, "
        "at -90 degrees by default, with their frequency, force and amplitude."
    ),
    ("curve", "S-curve", "phase-locked", "locked_phase", "unstable branch"): (
        "Kind of test `curve`: points at which a controller holds the amplitude, in the order "
        "measured. Plotted against the force they form S-curves, whose middle part is unstable "
        "under a constant force. At such a point the amplitude is known; the model predicts the "
        "force, and either the phase at the measured frequency or the frequency at the held phase. "
        "Therefore no point can jump to another branch."
    ),
    ("mode",): (
        "A natural frequency of the structure with its shape and damping. With matrices, the modes "
        "are those with fully stuck joints."
    ),
    ("swept",): "Modes that a test of the campaign excites; they distinguish the joints.",
    ("cycle", "cycles"): "The part of a loop from one maximum of the displacement to the next.",
    ("work [J]",): "Energy dissipated in one cycle of a loop.",
    ("equivalent damping",): (
        "Damping ratio of the linear spring and damper that dissipate the same energy in a cycle: "
        "the work divided by 2 pi, by the stiffness and by the squared amplitude."
    ),
    ("stiffness / stiffness of first cycle of equal amplitude",): (
        "Secant stiffness of a cycle, divided by that of the first cycle of equal amplitude. "
        "Below 1 the joint degrades."
    ),
    ("share",): (
        "A fraction: the fraction of the stiffness that slips, of the draws, or of the response."
    ),
    ("CHECK",): (
        "Mark of `jbw init` on a line of a campaign file whose value the records do not state. "
        "Check the value before you identify."
    ),
    ("session",): (
        "A day, or a working shift, in which nothing was changed. `run` in a `[[test]]` names the "
        "session. Each session may have its own offsets of natural frequency and damping."
    ),
    ("remark",): (
        "Additional information on a row, such as how many repeats of a test were fitted."
    ),
    ("why not",): (
        "Why a law was not compared with the others: its fit failed, or it is by construction the "
        "same as another law."
    ),
}


def words() -> dict[str, str]:
    """Return a dictionary from each word or column heading, in lower case, to its meaning."""
    return {name.lower(): meaning for names, meaning in WORDS.items() for name in names}
