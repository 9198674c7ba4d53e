"""The result of an identification, returned by `identify` or read from a run's folder."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import scipy.sparse
import xarray as xr

from jbw.campaign.load import Campaign, load_campaign, with_laws
from jbw.errors import ConfigError
from jbw.forced.profiles import RandomProfile
from jbw.forced.shock import Pulse, pulse_of
from jbw.identification.procedure import Identification, Known
from jbw.inference.posterior.finding import Verdict, kept_verdict
from jbw.measurement.records import Test
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator
from jbw.report.formats import formats_of
from jbw.report.opening import known_parameters
from jbw.report.result import node, of_another_version, read_result
from jbw.results.attributes import DrawnPosterior, StoredVariable
from jbw.results.run import RunSummary
from jbw.run.files import hash_of
from jbw.study.frames import backbone_frame, page_of, parameter_frame, prediction_frame
from jbw.study.loads import Load, LoadOptions, joints_of_basis, load_on
from jbw.study.loads_in_time import random_of, shock_of
from jbw.study.loads_of_sines import notch_of, resonance_of, response_curve_of
from jbw.study.store import claim, save_report, save_result
from jbw.verification.planned import planned_sweep
from jbw.verification.predict import Request, chosen, predict
from jbw.verification.predictive_basis import GROUPS_OF_BASIS, NUM_DRAWS, Basis, basis_of

if TYPE_CHECKING:
    from pandas import DataFrame


LINE = 300  # largest number of characters of the line with the parameters in a notebook cell


@dataclass(frozen=True, repr=False)
class Study:
    """The result of `identify`, or of a saved run.

    Attributes:
        tree: Content of `posterior.nc`: the main posterior in ArviZ's groups at the root, the other
            steps under `steps`, then `verification` and `validation`.
        record: Content of `summary.json`.
        campaign: The identified campaign; None where its file is not available.
        identification: Every step with its fit and verdict; None for a saved run.

    Examples:
        The fit predicts the mean of two repeats to their noise, 2 % / sqrt(2):

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> study = jbw.identify(campaign, quick=True)
        >>> print(f"{study.predict('sweep_0p20V', num_draws=20).attrs['nrmse']:.1%}")
        1.4%
        >>> study.backbone().to_csv("backbone.csv")  # frequency and damping at each amplitude
    """

    tree: xr.DataTree
    record: dict[str, Any]
    campaign: Campaign | None = None
    identification: Identification | None = None

    def __repr__(self) -> str:
        judged = [repr(self.verdict)] if self.result.verdict.status else []
        return "\n".join([*judged, self._known()])

    def _repr_html_(self) -> str:
        verdict = self.verdict._repr_html_() if self.result.verdict.status else ""
        return verdict + page_of(self.result, self.tree)

    def _known(self) -> str:
        """Return one line of text with the campaign and its determined parameters."""
        listed = "; ".join(known_parameters(self.result)) or "no parameter is known"
        return shorten(f"Study of {self.result.campaign}: {listed}", LINE)

    @cached_property
    def result(self) -> RunSummary:
        """The content of `record` as typed objects."""
        return RunSummary.read(self.record)

    @property
    def posterior(self) -> xr.DataTree:
        """The study's result tree; its groups of the main posterior have ArviZ's names."""
        return self.tree

    @property
    def verdict(self) -> Verdict:
        """The verdict on the main posterior."""
        return kept_verdict(self.result.verdict)

    def summary(self) -> dict[str, Any]:
        """Return all steps and parameters in numbers, with sentences on what the data determine."""
        return self.record

    def table(self, step: str | None = None) -> "DataFrame":
        """Return the parameters of a step as a data frame in SI units.

        Columns: `unit`, `mean`, `sd`, `cv` (sd over mean), `q005` and `q995` (ends of the 99 %
        interval), `map`, `kl` [nats], `ess_bulk` and `r_hat`, as far as the step has them.

        Args:
            step: Name of a step, as in `summary()["steps"]`; the main step when None.

        Returns:
            One row per parameter.

        Raises:
            ConfigError: The run has no step of that name.
        """
        return parameter_frame(self.result, step)

    def backbone(self) -> "DataFrame":
        """Return natural frequency and damping ratio at each amplitude, with 99 % bands.

        Columns: the medians `frequency_hz` [Hz] and `damping` [-], the ends of their bands with the
        suffixes `_low` and `_high`, and `fitted`: whether the amplitude lies within the fitted
        range. Columns with `_free` after the quantity state the same for the law without a
        prescribed form, from the readings of fitted tests, where there are enough; NaN far from the
        readings.

        Returns:
            One row per amplitude of the displacement [m]; where several joints were identified, one
            row per mode and amplitude at the first point.

        Raises:
            DataError: The joint has no mode, or no motion was measured.
        """
        return backbone_frame(self.tree)

    def predictions(self) -> "DataFrame":
        """Return the error and coverage of the prediction of each test, as a data frame.

        Columns: `kind`, `level`, `level_unit`, `fitted` (False: held out), `nrmse` (error / rms
        of the record), `nrmse_own_frequency` (the same with a separate natural frequency for
        each free decay), `coverage` and `half_width` of the 99 % band, `nrmse_linear` and
        `nrmse_cubic` (the best oscillator without a joint), and `extrapolation`, as far as a test
        has them.

        Returns:
            One row per predicted test; none after a quick run, which predicts no test.
        """
        return prediction_frame(self.result)

    def predict(
        self, test: str | Test, num_draws: int = NUM_DRAWS, *, noise: bool = True
    ) -> xr.Dataset:
        """Predict any test: bands of the main posterior, together with the measured values.

        Args:
            test: Name of a test of the campaign, or a test of any kind, whether measured before or
                not.
            num_draws: Number of draws that the model propagates; fewer for long records.
            noise: Whether the bands include the measurement noise, where it is known.

        Raises:
            ConfigError: The campaign has no test of that name, or is not available.
            DataError: The source of the test has another unit than that of the run.
        """
        if isinstance(test, str):
            if self.campaign is None:
                raise ConfigError(
                    f"Argument `test` names {test!r}, but the campaign of the run is not "
                    "available.",
                    remedy="Pass the test itself, or load the study with `campaign=`.",
                )
            (test,) = chosen(self.campaign.tests, (test,), "Argument `test`")
        return predict(basis_of(self.tree), test, Request(num_draws, noise))

    def planned_sweep(
        self, band_hz: tuple[float, float], level: float, *, duration: float, fs: float
    ) -> Test:
        """Return a linear sweep from rest that was not measured, for `predict`.

        Args:
            band_hz: First and last frequency [Hz].
            level: Amplitude in the unit of the run's source.
            duration: Duration of the sweep [s]; its amplitude decreases to zero over the last 2 %.
            fs: Sampling frequency [Hz], above twice the highest frequency.

        Raises:
            ConfigError: A number is not positive, or the sweep goes beyond half of `fs`.
        """
        return planned_sweep(basis_of(self.tree), band_hz, level, duration, fs)

    def joints(self, draws: int = NUM_DRAWS) -> Oscillator | Structure:
        """Return an oscillator whose parameters are arrays over the posterior draws.

        Its arrays have the shape (draw,); `jbw.simulate` and `jbw.steady_state` accept it. Of
        several modes or joints it is a structure, whose arrays have a first axis of draws.

        Raises:
            ConfigError: There are fewer than two draws.
        """
        return joints_of_basis(basis_of(self.tree), draws)

    def response_curve(
        self, level: float, band: tuple[float, float], **options: Unpack[LoadOptions]
    ) -> xr.Dataset:
        """Return the response curve of a sine of one level over a band, including jumps.

        Args:
            level: Amplitude in the unit of the run's source; in m/s^2 for a moving base.
            band: First and last frequency [Hz].
            options: `drive` (`force`, the default, for the run's source, or `base`), `draws`,
                `participation` and `shape` of the mode on a moving base, `harmonics`, `unit` of the
                response (by default that of the records), `seed`, `mode` (for `resonance`, from 1).

        Returns:
            `frequency` [Hz], `amplitude`, `phase` [rad] and `stable` by (draw, point) along the
            curves; `upward` and `downward`, the 99 % bands over (quantile, freq) of the response in
            slow sweeps. Attributes state what the bands contain, and `reach`: the ratio of the peak
            displacement to the largest fitted displacement.

        Raises:
            ConfigError: A level, band or option is invalid.
            DataError: The run determines no gain.
            ModelError: There is no resonance at this level, or two of several modes are nearer
                than ten half-power widths.
        """
        basis = basis_of(self.tree)
        return response_curve_of(basis, level, band, load_on(basis, Load(**options)))

    def resonance(self, levels: Iterable[float], **options: Unpack[LoadOptions]) -> xr.Dataset:
        """Return frequency, height, Q, half-power width and jumps of the resonance at each level.

        Args:
            levels: Amplitudes, in the unit that `response_curve` takes.
            options: Options of `response_curve`.

        Returns:
            Variables over (quantile, level) with 99 % intervals. `quality` and `half_power_width`
            come from the draws whose curve does not fold between the half-power points, the jumps
            from the draws whose curve folds; `folds` is the share of the latter.

        Raises:
            ConfigError, DataError, ModelError: As for `response_curve`.
        """
        basis = basis_of(self.tree)
        return resonance_of(basis, levels, load_on(basis, Load(**options)))

    def notch(
        self,
        level: float,
        limit: float,
        band: tuple[float, float],
        **options: Unpack[LoadOptions],
    ) -> xr.Dataset:
        """Return the level of a sine that keeps the response within a limit at each frequency.

        Args:
            level: Requested amplitude of the sine.
            limit: Largest amplitude of the response, in the unit of the response.
            band: First and last frequency [Hz].
            options: Options of `response_curve`.

        Returns:
            `allowed` and `notched` (the smaller of `allowed` and `level`) over (quantile, freq), in
            the unit of the source.

        Raises:
            ConfigError, DataError, ModelError: As for `response_curve`.
        """
        basis = basis_of(self.tree)
        return notch_of(basis, level, limit, band, load_on(basis, Load(**options)))

    def random(
        self,
        profile: RandomProfile,
        duration: float = 60.0,
        sine: tuple[float, float] | None = None,
        **options: Unpack[LoadOptions],
    ) -> xr.Dataset:
        """Return the response to random vibration of a given profile, by averaging the energy.

        Args:
            profile: Spectral density of the source, from `jbw.read_profile` or `jbw.profile_of`.
            duration: Duration for which the largest displacement is stated [s].
            sine: Frequency [Hz] and amplitude, in the unit of the source, of a sine beside the
                random vibration.
            options: Options of `response_curve`.

        Returns:
            99 % intervals of `rms` and `psd` of the response; of the rms, largest displacement and
            peak factor of the relative motion; of the rate of upward crossings and the equivalent
            damping. With a sine, these are of the random part; `sine` is the amplitude of the
            response at its frequency, and the largest displacement contains it.

        Raises:
            ConfigError: A unit does not fit the source.
            DataError: The run determines no gain.
            ModelError: The profile has no power at a mode or is too narrow, the damping is above
                5 %, a sine is within ten half-power widths of the mode, or several modes move the
                joint at the same time.
        """
        basis = basis_of(self.tree)
        return random_of(basis, profile, duration, load_on(basis, Load(**options)), sine)

    def shock(self, pulse: str | Pulse, **options: Unpack[LoadOptions]) -> xr.Dataset:
        """Return the motion under a shock: the band over time, the largest value, and the spectrum.

        Args:
            pulse: A text such as `20g,11ms`, for a half-sine unless a third word says `sawtooth` or
                `trapezoid`; or a `jbw.Pulse` of samples.
            options: Options of `response_curve`; the modes outside the band are ignored.

        Raises:
            ConfigError: The shock is invalid, or in another unit than the source.
            DataError: The run determines no gain.
            ModelError: The run has several modes.
        """
        stated = pulse_of(pulse) if isinstance(pulse, str) else pulse
        basis = basis_of(self.tree)
        return shock_of(basis, stated, load_on(basis, Load(**options)))

    def save(self, folder: str | Path, *, figures: Sequence[str] = ()) -> None:
        """Write posterior.nc, summary.json and report.html into an empty folder.

        Args:
            folder: The output folder.
            figures: File formats in which the figures are saved in `folder`/figures: "png", "svg",
                "pdf".

        Raises:
            ConfigError: A format is none of these.
            RunError: The folder is not empty, or cannot be written.
        """
        formats = formats_of(figures, "Argument `figures`")
        claimed = claim(Path(folder))
        save_result(claimed, self.tree, self.record)
        save_report(claimed, self.tree, self.result, formats=formats)


def load_study(folder: str | Path, campaign: Campaign | None = None) -> Study:
    """Load the result of a run that `jbw identify` or `Study.save` saved.

    Args:
        folder: The run's folder.
        campaign: The identified campaign. When None, it is read from the path stored in the run, if
            a file is still there.

    Raises:
        DataError: The folder contains no finished run, or the run cannot be read.

    Examples:
        A saved run is loaded with its campaign:

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> jbw.identify(campaign, quick=True).save("run")
        >>> study = jbw.load_study("run", campaign)
        >>> print(f"{study.table()['mean']['omega_n']:.2f} rad/s,", study.verdict.status)
        118.12 rad/s, not assessed
    """
    summary, tree = read_result(Path(folder))
    if "posterior" in tree.children:
        # If a run cannot be used for predictions, this raises the error now.
        _basis(Path(folder), summary, tree)
    where = summary.campaign_file
    if campaign is None and where is not None and Path(where).is_file():
        # The run was allowed to read files outside its folder.
        campaign = load_campaign(where, allow_outside=True)
    if campaign is not None:
        campaign = with_laws(campaign, DrawnPosterior.of(tree).laws)
    return Study(tree, summary.plain(), campaign)


def basis_of_run(folder: Path) -> Basis:
    """Return the posterior draws and settings with which a finished run makes predictions."""
    return _basis(folder, *read_result(folder, *GROUPS_OF_BASIS))


def _basis(folder: Path, summary: RunSummary, tree: xr.DataTree) -> Basis:
    try:
        return basis_of(tree)
    except (KeyError, TypeError, ValueError) as cause:
        what = f"{type(cause).__name__} {cause}"
        raise of_another_version(folder, summary.versions, what) from cause


def campaign_of(folder: Path, stated: Path | None = None) -> Path:
    """Return the path of a run's campaign file: the given path, or the one stored in the run."""
    summary, _ = read_result(folder, "posterior")
    within = sorted(folder.glob("*/campaign.toml"))
    for campaign_path in filter(None, [stated, summary.campaign_file, *within]):
        for path in (folder / campaign_path, Path(campaign_path)):
            if path.is_file():
                return path
    raise ConfigError(
        f"The run in {folder} does not state the path of its campaign file.",
        why="This command reads the records of the campaign again.",
        remedy="Give the campaign file with --campaign.",
    )


def known_of(folder: Path) -> tuple[RunSummary, Known]:
    """Return a run's summary, prior bounds, and posterior means of Step 3."""
    summary, tree = read_result(folder, "posterior", "steps")
    bounds, means = {}, {}
    if summary.main == "joint" and "posterior" in tree.children:
        for name, values in tree["posterior"].data_vars.items():
            if (stated := StoredVariable.of(values).bounds) is not None:
                bounds[str(name)] = stated
    third_order = node(tree, "steps/third_order_nuts/posterior")
    if third_order is not None:
        means = {str(name): float(values.mean()) for name, values in third_order.data_vars.items()}
    return summary, Known(bounds, means)


def require_same_inputs(campaign: Campaign, summary: RunSummary) -> None:
    """Raise an error if a campaign's records differ from those listed in a run's summary."""
    now, then = set(input_hashes(campaign).values()), set(summary.inputs.values())
    if then and now != then:
        raise ConfigError(
            f"The campaign {campaign.name} has other records than the run: {len(now - then)} of "
            f"its {len(now)} files are new or were changed.",
            remedy="Give the run's campaign file with --campaign, or a campaign file in place of "
            "the run.",
        )


def inputs_of(campaign: Campaign) -> dict[str, str]:
    """Return the SHA-256 hash of every file and matrix from which a campaign was read."""
    read = {**input_hashes(campaign), str(campaign.path): hash_of(campaign.path)}
    if campaign.joints is None:
        return read
    model = campaign.joints.model.matrices
    digest = hashlib.sha256(repr((model.dofs, model.units, model.positions)).encode())
    for matrix in (model.mass, model.stiffness, model.damping):
        values = scipy.sparse.coo_array((0, 0) if matrix is None else matrix)
        for array in (values.row, values.col, values.data):
            digest.update(np.ascontiguousarray(array))
    return {**read, "matrices": digest.hexdigest()}


def input_hashes(campaign: Campaign) -> dict[str, str]:
    """Return the SHA-256 hash of every record's source file, by path."""
    records = [record for test in campaign.tests for record in test.records]
    sources = [r.provenance for r in records if "sha256" in r.provenance]
    return {source.get("path", ""): source["sha256"] for source in sources}
